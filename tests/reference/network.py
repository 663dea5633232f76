"""A patch network, one multiplication at a time, and patches cut pixel by pixel."""

import math

import numpy as np


def convolve(maps: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Convolve maps (C, H, W) with kernels (K, C, s, s): (K, H-s+1, W-s+1)."""
    kernels, _, size, _ = weight.shape
    height, width = maps.shape[1] - size + 1, maps.shape[2] - size + 1
    result = np.empty((kernels, height, width))
    for kernel in range(kernels):
        for row in range(height):
            for column in range(width):
                under = maps[:, row : row + size, column : column + size]
                result[kernel, row, column] = (under * weight[kernel]).sum() + bias[kernel]
    return result


def subsample(maps: np.ndarray, pooling: str) -> np.ndarray:
    """Subsample maps (C, H, W), H and W even, by 2×2."""
    channels, height, width = maps.shape
    blocks = maps.reshape(channels, height // 2, 2, width // 2, 2)
    return blocks.mean((2, 4)) if pooling == "mean" else blocks.max((2, 4))


def potentials(
    patch: np.ndarray, weights: dict[str, np.ndarray], subsamplings: int, pooling: str, ends: str
) -> np.ndarray:
    """Return potentials (3,) of a normalised patch (3, P, P); weights as the network names them."""
    maps = np.tanh(convolve(patch, weights["first.weight"], weights["first.bias"]))
    maps = subsample(maps, pooling)
    maps = np.tanh(convolve(maps, weights["second.weight"], weights["second.bias"]))
    if subsamplings == 2:
        maps = subsample(maps, pooling)
    scores = convolve(maps, weights["last.weight"], weights["last.bias"]).reshape(3)
    if ends == "softmax":
        return np.exp(scores) / np.exp(scores).sum()
    return 1 / (1 + np.exp(-scores))


def bounce(place: float, length: int) -> float:
    """Reflect a position on a line of ``length`` pixels at the first and the last."""
    last = length - 1
    if last == 0:
        return 0.0
    while not 0 <= place <= last:
        place = -place if place < 0 else 2 * last - place
    return place


def patch_around(pixels: np.ndarray, row: int, column: int, patch: int) -> np.ndarray:
    """Return the patch (C, P, P) of a pixel of (C, H, W), reflected at the border."""
    return jittered_patch(pixels, row, column, patch, 1.0, 0.0)


def jittered_patch(
    pixels: np.ndarray, row: float, column: float, patch: int, scale: float, turn: float
) -> np.ndarray:
    """Return a magnified and rotated patch (C, P, P), bilinear, pixel by pixel."""
    _, height, width = pixels.shape
    result = np.empty((pixels.shape[0], patch, patch))
    for i in range(patch):
        for j in range(patch):
            down, across = i - patch // 2, j - patch // 2
            y = row + (math.cos(turn) * down - math.sin(turn) * across) / scale
            x = column + (math.sin(turn) * down + math.cos(turn) * across) / scale
            result[:, i, j] = bilinear(pixels, bounce(y, height), bounce(x, width))
    return result


def bilinear(pixels: np.ndarray, y: float, x: float) -> np.ndarray:
    """Interpolate between the four pixels around a position inside."""
    top, left = min(int(y), pixels.shape[1] - 1), min(int(x), pixels.shape[2] - 1)
    low, right = min(top + 1, pixels.shape[1] - 1), min(left + 1, pixels.shape[2] - 1)
    a, b = y - top, x - left
    above = pixels[:, top, left] * (1 - b) + pixels[:, top, right] * b
    below = pixels[:, low, left] * (1 - b) + pixels[:, low, right] * b
    return above * (1 - a) + below * a
