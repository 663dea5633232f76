"""CNN-7 in NumPy: an epoch of its training by P2 (sections 3.1 and 6.1), gradients by hand.

Superpixels, machine labels, initial weights and random draws are inputs. What P2 leaves open is
read as in docs/how/layout_texture.md and configs/cnn7-paper.toml.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

Array = np.ndarray
Weights = dict[str, Array]

PATCH, RADIUS, RATE, GAIN = 32, 4.0, 0.05, 4.0


class Jitter(NamedTuple):
    """Draws of n patches: magnification, angle in radians, noise (n, 3, 32, 32) in grey levels."""

    scale: Array
    angle: Array
    noise: Array


def epoch(
    weights: Weights, patches: Array, classes: Array, steps: Iterable[Array]
) -> tuple[Weights, float]:
    """Return the weights after one step for each index array, and the mean error of a patch."""
    total = 0.0
    for step in steps:
        error, slopes = error_and_gradient(weights, patches[step], classes[step])
        weights = {name: weights[name] - RATE * slopes[name] / len(step) for name in weights}
        total += error
    return weights, total / len(patches)


def centres(segments: Array) -> Array:
    """Return the centroid of each superpixel and four places around it, int (n, 2)."""
    places = []
    for segment in range(segments.max() + 1):
        row, column = np.argwhere(segments == segment).mean(0)
        for down, across in ((0, 0), (RADIUS, 0), (0, RADIUS), (-RADIUS, 0), (0, -RADIUS)):
            places.append((row + down, column + across))
    return np.clip(np.round(places), 0, np.array(segments.shape) - 1).astype(int)


def jittered_patches(image: Array, places: Array, jitter: Jitter) -> Array:
    """Return patches (n, 3, 32, 32) of an image (3, H, W) in [0, 1], as the network takes them."""
    pixels = (image - 0.5) * GAIN
    steps = np.arange(PATCH) - PATCH // 2
    result = []
    for (row, column), scale, angle in zip(places, jitter.scale, jitter.angle, strict=True):
        down, across = np.cos(angle) * steps / scale, np.sin(angle) * steps / scale
        rows = row + down[:, None] - across
        columns = column + across[:, None] + down
        result.append(interpolated(pixels, rows, columns))
    return np.array(result) + jitter.noise * GAIN / 255


def interpolated(pixels: Array, rows: Array, columns: Array) -> Array:
    """Return (3, H, W) at positions, bilinear, mirrored at the first and last row and column."""
    corners, fractions = [], []
    for positions, length in zip((rows, columns), pixels.shape[1:], strict=True):
        mirrored = abs((positions + length - 1) % (2 * length - 2) - (length - 1))
        corners.append(np.minimum(mirrored.astype(int), length - 2))
        fractions.append(mirrored - corners[-1])
    (top, left), (low, right) = corners, fractions
    above = pixels[:, top, left] * (1 - right) + pixels[:, top, left + 1] * right
    below = pixels[:, top + 1, left] * (1 - right) + pixels[:, top + 1, left + 1] * right
    return above * (1 - low) + below * low


# --- the network ---------------------------------------------------------------------------


def convolve(maps: Array, weight: Array, bias: Array) -> Array:
    """Convolve maps (n, C, H, W) with kernels (K, C, s, s), each connected to all maps."""
    windows = sliding_window_view(maps, weight.shape[2:], (2, 3))
    sums = np.tensordot(windows, weight, ((1, 4, 5), (1, 2, 3)))
    return (sums + bias).transpose(0, 3, 1, 2)


def mean_of_squares(maps: Array) -> Array:
    """Subsample maps (n, C, H, W) by the mean of 2x2."""
    count, channels, height, width = maps.shape
    return maps.reshape(count, channels, height // 2, 2, width // 2, 2).mean((3, 5))


def potentials(weights: Weights, patches: Array) -> tuple[Array, Array, Array, Array]:
    """Return the potentials (n, 3, 1, 1) of patches, and the maps of the stages before."""
    first = np.tanh(convolve(patches, weights["first.weight"], weights["first.bias"]))
    small = mean_of_squares(first)
    second = np.tanh(convolve(small, weights["second.weight"], weights["second.bias"]))
    scores = convolve(second, weights["last.weight"], weights["last.bias"])
    return 1 / (1 + np.exp(-scores)), first, small, second


def error_and_gradient(weights: Weights, patches: Array, classes: Array) -> tuple[float, Weights]:
    """Return the sum of squared differences to the labels, and its derivative by each weight."""
    output, first, small, second = potentials(weights, patches)
    difference = output - np.eye(3)[classes][:, :, None, None]
    by_scores = 2 * difference * output * (1 - output)
    by_second = input_slope(weights["last.weight"], by_scores) * (1 - second**2)
    by_small = input_slope(weights["second.weight"], by_second)
    by_first = by_small.repeat(2, 2).repeat(2, 3) / 4 * (1 - first**2)
    return float((difference**2).sum()), {
        **kernel_slopes("first", patches, by_first),
        **kernel_slopes("second", small, by_second),
        **kernel_slopes("last", second, by_scores),
    }


def kernel_slopes(name: str, maps: Array, slope: Array) -> Weights:
    """Return the derivatives by kernels and biases, of maps below and the slope above a layer."""
    windows = sliding_window_view(maps, slope.shape[2:], (2, 3))
    by_kernel = np.tensordot(slope, windows, ((0, 2, 3), (0, 4, 5)))
    return {f"{name}.weight": by_kernel, f"{name}.bias": slope.sum((0, 2, 3))}


def input_slope(weight: Array, slope: Array) -> Array:
    """Return the derivative by the maps below a layer with kernels (K, C, s, s)."""
    margin = weight.shape[-1] - 1
    padded = np.pad(slope, ((0, 0), (0, 0), (margin, margin), (margin, margin)))
    turned = weight[:, :, ::-1, ::-1].transpose(1, 0, 2, 3)
    return convolve(padded, turned, np.zeros(len(turned)))
