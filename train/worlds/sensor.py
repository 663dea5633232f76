"""From linear light to an image: lens errors, dirty glass, exposure, tone curve, noise, JPEG."""

from typing import NamedTuple

import cv2
import numpy as np

from train.worlds.truth import EGO, VOID

Random = np.random.Generator


class Photo(NamedTuple):
    """A developed image, uint8 (H, W, 3) BGR, its truth, uint8 (H, W), and its JPEG quality."""

    image: np.ndarray
    truth: np.ndarray
    quality: int


class Exposure(NamedTuple):
    """Conditions of an image: a light of ``train.worlds.plans``, rain or snow in the air, speed.

    falling, speed: 0 to 1. circle: pixels that a fisheye sees (H, W); the rest is black and void.
    """

    light: str
    falling: float = 0.0
    speed: float = 0.0
    circle: np.ndarray | None = None


AIMS = {"night": (0.003, 0.06), "dusk": (0.012, 0.12), "day": (0.06, 0.26)}
"""Target grey of the exposure in linear light, from … to, by light."""


def develop(light: np.ndarray, truth: np.ndarray, exposure: Exposure, rng: Random) -> Photo:
    """Develop linear light, float32 (H, W, 3) BGR, as a camera does; distort the truth alike."""
    night, circle = exposure.light == "night", exposure.circle
    light = np.nan_to_num(light, posinf=1e4).clip(0, 1e4)
    if exposure.speed:
        light = blur_by_motion(light, truth, exposure.speed, rng)
    if exposure.falling:
        light = add_rain(light, exposure.falling, rng)
    if circle is not None:
        light = light * circle[..., None]
        truth = np.where(circle, truth, np.uint8(VOID))
    elif rng.random() < 0.3:
        light, truth = distort(light, truth, rng.uniform(-0.05, 0.28))
    visible = np.ones(truth.shape, bool) if circle is None else circle
    glare = rng.uniform(0.02, 0.15) if night else rng.choice([0.0, 0.05])  # about lamps
    bright = np.minimum(light, np.percentile(light, 99) * 8 + 1e-6)
    halo = cv2.GaussianBlur(bright, (0, 0), rng.uniform(4, 24))
    light = light * (1 - glare) + glare * halo
    y, x = np.mgrid[-1 : 1 : len(light) * 1j, -1 : 1 : light.shape[1] * 1j]
    dark = rng.choice([0.0, 0.1, 0.25, 0.5], p=[0.4, 0.3, 0.2, 0.1])  # corners
    vignette = (1 - dark * ((x * x + y * y) / 2) ** rng.uniform(1, 3)).astype(np.float32)
    light = light * sample_gain(light, visible, exposure.light, rng) * vignette[..., None]
    if rng.random() < (0.4 if exposure.falling else 0.22):
        light = add_dirty_glass(light, rng)
    if circle is not None:
        light = light * cv2.GaussianBlur(circle.astype(np.float32), (0, 0), 0.8)[..., None]
    tone = apply_tone_curve(light * np.exp(rng.normal(0, 0.05, 3)).astype(np.float32), rng)
    return Photo(quantise(tone, night, rng), truth, int(rng.integers(45, 96)))


def blur_by_motion(light: np.ndarray, truth: np.ndarray, speed: float, rng: Random) -> np.ndarray:
    """Blur away from a point near the middle, and by a shake; what carries the camera is sharp."""
    height, width = truth.shape
    centre = np.array([width * rng.uniform(0.4, 0.6), height * rng.uniform(0.25, 0.55)])
    reach, shake = 0.16 * speed * rng.random(), rng.normal(0, 4 * speed, 2)
    total = np.zeros_like(light)
    for step in np.linspace(-0.5, 0.5, 9):
        zoom = 1 + reach * step
        shift = centre * (1 - zoom) + shake * step
        matrix = np.array([[zoom, 0, shift[0]], [0, zoom, shift[1]]])
        total += cv2.warpAffine(light, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
    carrier = cv2.GaussianBlur((truth == EGO).astype(np.float32), (0, 0), 0.7)[..., None]
    return light * carrier + total / 9 * (1 - carrier)


def distort(light: np.ndarray, truth: np.ndarray, barrel: float) -> tuple[np.ndarray, np.ndarray]:
    """Distort by a lens, cropping what would come from outside the image."""
    height, width = truth.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    x, y = 2 * (x + 0.5) / width - 1, 2 * (y + 0.5) / height - 1
    scale = (1 + barrel * (x * x + y * y)) / (1 + 2 * max(barrel, 0.0))
    across, down = (
        ((axis * scale + 1) * side / 2 - 0.5).astype(np.float32)
        for axis, side in ((x, width), (y, height))
    )
    image = cv2.remap(light, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return image, cv2.remap(truth, across, down, cv2.INTER_NEAREST, borderValue=VOID)


def sample_gain(light: np.ndarray, visible: np.ndarray, light_name: str, rng: Random) -> float:
    """Return the gain of an automatic exposure, often a little off, by visible pixels (H, W)."""
    first = int(len(light) * rng.uniform(0, 0.5))
    grey = np.exp(np.log(light[first:].mean(2)[visible[first:]] + 1e-5).mean())
    aim = np.exp(rng.uniform(*np.log(AIMS.get(light_name, AIMS["day"]))))
    if light_name not in AIMS and rng.random() < 0.05:  # several times too dark
        aim *= rng.uniform(0.03, 0.2)
    return float(aim / grey)


def add_rain(light: np.ndarray, amount: float, rng: Random) -> np.ndarray:
    """Add streaks of rain or flakes, brighter than what is behind them, and a veil."""
    height, width = light.shape[:2]
    lit = (rng.random((height, width)) < 0.004 * amount * rng.uniform(0.3, 1.5)).astype(np.float32)
    length = int(rng.choice([1, 7, 15, 29]))
    lean, kernel = rng.uniform(-0.4, 0.4), np.zeros((length, length), np.float32)
    for row in range(length):
        kernel[row, int(length / 2 + lean * (row - length / 2))] = 1
    streaks = cv2.GaussianBlur(cv2.filter2D(lit, -1, kernel), (0, 0), rng.uniform(0.4, 0.9))
    grey = np.percentile(light.mean(2), 80)
    fraction = (streaks * rng.uniform(0.2, 0.8)).clip(0, 0.8)[..., None]
    light = light * (1 - fraction) + fraction * grey
    return light + 0.15 * amount * rng.random() * grey


def add_dirty_glass(light: np.ndarray, rng: Random) -> np.ndarray:
    """Add a dirty or wet windscreen: a veil, a reflection of the dashboard, drops."""
    height, width = light.shape[:2]
    cloth = cv2.resize(
        rng.random((5, 7)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC
    )
    fall = np.linspace(rng.uniform(0, 1), rng.uniform(0, 1), height, dtype=np.float32)[:, None]
    light = light + (rng.uniform(0.02, 0.15) * cloth.clip(0, 1) * fall)[..., None]
    if rng.random() < 0.4:
        soft = cv2.GaussianBlur(light, (0, 0), rng.uniform(2, 5))
        drops = np.zeros((height, width), np.float32)
        for _ in range(int(rng.integers(10, 120))):
            middle = (int(rng.integers(width)), int(rng.integers(height)))
            cv2.circle(drops, middle, int(rng.integers(1, 6) * height / 288), 1.0, -1)
        drops = cv2.GaussianBlur(drops, (0, 0), 1.0)[..., None]
        turned = soft[::-1] * rng.uniform(0.4, 0.9)
        light = light * (1 - drops) + drops * (0.6 * soft + 0.4 * turned)
    return light


def apply_tone_curve(light: np.ndarray, rng: Random) -> np.ndarray:
    """Apply a tone curve with a shoulder, and the camera's saturation and contrast, in [0, 1]."""
    shoulder = rng.uniform(0.0, 0.6)
    light = light * (1 + light * 0.1) / (1 + shoulder * light)
    tone = np.clip(light, 0, 1) ** (1 / rng.uniform(1.9, 2.5))
    steep = rng.uniform(0.0, 0.6)
    tone = tone + steep * (tone * tone * (3 - 2 * tone) - tone)
    grey = tone.mean(2, keepdims=True)
    return np.clip(grey + rng.uniform(0.45, 1.3) * (tone - grey), 0, 1)


def quantise(tone: np.ndarray, night: bool, rng: Random) -> np.ndarray:
    """Blur or sharpen, add noise, quantise to eight bits."""
    if rng.random() < 0.5:
        tone = cv2.GaussianBlur(tone, (0, 0), rng.uniform(0.3, 1.1))
    elif rng.random() < 0.4:
        tone = tone + rng.uniform(0.2, 0.8) * (tone - cv2.GaussianBlur(tone, (0, 0), 1.0))
    spread = rng.uniform(0.0, 0.045 if night else 0.015)
    coarse = rng.normal(0, spread, tone.shape) + rng.normal(0, spread, tone.shape[:2])[..., None]
    return (np.clip(tone + coarse, 0, 1) * 255 + 0.5).astype(np.uint8)
