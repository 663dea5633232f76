"""From linear light to an image: lens errors, dirty glass, exposure, tone curve, noise, JPEG."""

from typing import NamedTuple

import cv2
import numpy as np

from train.worlds.truth import VOID

Random = np.random.Generator


class Look(NamedTuple):
    """A developed image, uint8 (H, W, 3) BGR, its truth, uint8 (H, W), and its JPEG quality."""

    image: np.ndarray
    truth: np.ndarray
    quality: int


AIMS = {"night": (0.003, 0.06), "dusk": (0.012, 0.12), "day": (0.06, 0.26)}
"""Target grey of the exposure in linear light, from … to, by time of day."""

UNDEREXPOSED = 0.05
"""Fraction of images by day that are several times too dark."""


def develop(
    light: np.ndarray,
    truth: np.ndarray,
    hour: str,
    at: Random,
    falling: float = 0.0,
    circle: np.ndarray | None = None,
) -> Look:
    """Develop linear light, float32 (H, W, 3) BGR, as a camera does; distort the truth alike.

    falling: rain or snow in the air, 0 to 1. circle: pixels that a fisheye sees (H, W); the rest is
    black and void.
    """
    night, light = hour == "night", np.nan_to_num(light, posinf=1e4).clip(0, 1e4)
    if falling:
        light = through_rain(light, falling, at)
    if circle is not None:
        light = light * circle[..., None]
        truth = np.where(circle, truth, np.uint8(VOID))
    elif at.random() < 0.3:
        light, truth = bent(light, truth, at.uniform(-0.05, 0.28))
    seen = np.ones(truth.shape, bool) if circle is None else circle
    light = with_glare(light, night, at)
    light = light * exposure(light, seen, hour, at) * vignette(light.shape, at)
    if at.random() < (0.4 if falling else 0.22):
        light = behind_glass(light, at)
    if circle is not None:
        light = light * cv2.GaussianBlur(circle.astype(np.float32), (0, 0), 0.8)[..., None]
    tone = toned(light * np.exp(at.normal(0, 0.05, 3)).astype(np.float32), at)
    return Look(stored(tone, night, at), truth, int(at.integers(45, 96)))


def bent(light: np.ndarray, truth: np.ndarray, barrel: float) -> tuple[np.ndarray, np.ndarray]:
    """Distort by a lens, cropping what would come from outside the image."""
    height, width = truth.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    x, y = 2 * (x + 0.5) / width - 1, 2 * (y + 0.5) / height - 1
    scale = (1 + barrel * (x * x + y * y)) / (1 + 2 * max(barrel, 0.0))
    across, down = (
        ((axis * scale + 1) * side / 2 - 0.5).astype(np.float32)
        for axis, side in ((x, width), (y, height))
    )
    seen = cv2.remap(light, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return seen, cv2.remap(truth, across, down, cv2.INTER_NEAREST, borderValue=VOID)


def with_glare(light: np.ndarray, night: bool, at: Random) -> np.ndarray:
    """Add halos around very bright pixels, more of them at night."""
    share = at.uniform(0.02, 0.15) if night else at.choice([0.0, 0.05])
    top = np.percentile(light, 99) * 8 + 1e-6
    wide = at.uniform(3, 18) * len(light) / 288
    return light * (1 - share) + share * cv2.GaussianBlur(np.minimum(light, top), (0, 0), wide)


def exposure(light: np.ndarray, seen: np.ndarray, hour: str, at: Random) -> float:
    """Return the gain of an automatic exposure, often a little off, by the seen pixels (H, W)."""
    first = int(len(light) * at.uniform(0, 0.5))
    grey = np.exp(np.log(light[first:].mean(2)[seen[first:]] + 1e-5).mean())
    aim = np.exp(at.uniform(*np.log(AIMS.get(hour, AIMS["day"]))))
    if hour not in AIMS and at.random() < UNDEREXPOSED:
        aim *= at.uniform(0.03, 0.2)
    return float(aim / grey)


def vignette(shape: tuple[int, ...], at: Random) -> np.ndarray:
    """Return the darkening towards the corners, (H, W, 1)."""
    y, x = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
    dark = at.choice([0.0, 0.1, 0.25, 0.5], p=[0.4, 0.3, 0.2, 0.1])
    return (1 - dark * ((x * x + y * y) / 2) ** at.uniform(1, 3)).astype(np.float32)[..., None]


def through_rain(light: np.ndarray, much: float, at: Random) -> np.ndarray:
    """Add streaks of rain or flakes, brighter than what is behind them, and a veil."""
    height, width = light.shape[:2]
    lit = (at.random((height, width)) < 0.004 * much * at.uniform(0.3, 1.5)).astype(np.float32)
    length = int(at.choice([1, 7, 15, 29]))
    lean, kernel = at.uniform(-0.4, 0.4), np.zeros((length, length), np.float32)
    for row in range(length):
        kernel[row, int(length / 2 + lean * (row - length / 2))] = 1
    streaks = cv2.GaussianBlur(cv2.filter2D(lit, -1, kernel), (0, 0), at.uniform(0.4, 0.9))
    grey = np.percentile(light.mean(2), 80)
    share = (streaks * at.uniform(0.2, 0.8)).clip(0, 0.8)[..., None]
    light = light * (1 - share) + share * grey
    return light + 0.15 * much * at.random() * grey


def behind_glass(light: np.ndarray, at: Random) -> np.ndarray:
    """Add a dirty or wet windscreen: a veil, a reflection of the dashboard, drops."""
    height, width = light.shape[:2]
    cloth = cv2.resize(
        at.random((5, 7)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC
    )
    fall = np.linspace(at.uniform(0, 1), at.uniform(0, 1), height, dtype=np.float32)[:, None]
    light = light + (at.uniform(0.02, 0.15) * cloth.clip(0, 1) * fall)[..., None]
    if at.random() < 0.4:
        soft = cv2.GaussianBlur(light, (0, 0), at.uniform(2, 5))
        drops = np.zeros((height, width), np.float32)
        for _ in range(int(at.integers(10, 120))):
            middle = (int(at.integers(width)), int(at.integers(height)))
            cv2.circle(drops, middle, int(at.integers(1, 6) * height / 288), 1.0, -1)
        drops = cv2.GaussianBlur(drops, (0, 0), 1.0)[..., None]
        turned = soft[::-1] * at.uniform(0.4, 0.9)
        light = light * (1 - drops) + drops * (0.6 * soft + 0.4 * turned)
    return light


def toned(light: np.ndarray, at: Random) -> np.ndarray:
    """Apply a tone curve with a shoulder, and the camera's saturation and contrast, in [0, 1]."""
    shoulder = at.uniform(0.0, 0.6)
    light = light * (1 + light * 0.1) / (1 + shoulder * light)
    tone = np.clip(light, 0, 1) ** (1 / at.uniform(1.9, 2.5))
    steep = at.uniform(0.0, 0.6)
    tone = tone + steep * (tone * tone * (3 - 2 * tone) - tone)
    grey = tone.mean(2, keepdims=True)
    return np.clip(grey + at.uniform(0.45, 1.3) * (tone - grey), 0, 1)


def stored(tone: np.ndarray, night: bool, at: Random) -> np.ndarray:
    """Blur or sharpen, add noise, quantise to eight bits."""
    if at.random() < 0.5:
        tone = cv2.GaussianBlur(tone, (0, 0), at.uniform(0.3, 1.1))
    elif at.random() < 0.4:
        tone = tone + at.uniform(0.2, 0.8) * (tone - cv2.GaussianBlur(tone, (0, 0), 1.0))
    much = at.uniform(0.0, 0.045 if night else 0.015)
    coarse = at.normal(0, much, tone.shape) + at.normal(0, much, tone.shape[:2])[..., None]
    return (np.clip(tone + coarse, 0, 1) * 255 + 0.5).astype(np.uint8)
