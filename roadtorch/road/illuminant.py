"""Illuminant invariance: a plane in which shadows vanish, and the road's histogram in it.

Álvarez and López, "Road Detection Based on Illuminant Invariance", IEEE Trans. ITS 12(1), 2011.
Under Planckian light and narrow-band sensors, the log chromaticity (log R/G, log B/G) of a surface
moves along one direction when the light's temperature changes; the direction is the camera's. A
projection to the direction across it is invariant: sun and shadow on the road are equal there.
"""

import math

import numpy as np
import torch
from torch import Tensor

from roadtorch.road.texture import quantise_plane

MIN_LEVEL = 1 / 255
"""Lower bound of a channel before its logarithm. Ours: the least level above 0 in 8 bits."""

ANGLES = 180
"""Candidate directions, one a degree."""

ENTROPY_PIXELS = 20_000
"""Pixels that an entropy is estimated from, approximately. Ours: more do not move the minimum."""

CENTRAL_FRACTION = 0.9
"""Central fraction of the values that enters the entropy, against outliers (Finlayson 2004)."""

MODEL_BINS = 64
"""Bins of the road's histogram over the range of the plane. Ours."""

MODEL_SMOOTHING = (0.25, 0.5, 0.25)
"""Weights of neighbouring bins in the road's histogram. Ours, for seeds of few pixels."""


def log_chromaticity(image: Tensor) -> Tensor:
    """Compute (log R/G, log B/G) of an image (3, H, W) in [0, 1], shape (2, H, W).

    Values stay gamma-encoded: a gamma scales both and does not change the invariant direction.
    """
    red, green, blue = image.clamp_min(MIN_LEVEL).log()
    return torch.stack([red - green, blue - green])


def invariant_plane(chromaticity: Tensor, angle: float) -> Tensor:
    """Project log chromaticities (2, …) to the direction at ``angle`` degrees, shape (…)."""
    radians = math.radians(angle)
    return chromaticity[0] * math.cos(radians) + chromaticity[1] * math.sin(radians)


def projection_entropies(chromaticity: Tensor) -> Tensor:
    """Compute the Shannon entropy of each projection in bits, float64 (180,), by degrees.

    Histograms have Scott's bin width, 3.5 σ n^(-1/3), over the central values. Source: Finlayson,
    Drew and Lu, "Intrinsic Images by Entropy Minimization", ECCV 2004, section 3.
    """
    points = chromaticity.flatten(1).double()
    points = points[:, :: max(1, points.shape[1] // ENTROPY_PIXELS)].cpu()
    entropies = [_entropy(invariant_plane(points, angle).numpy()) for angle in range(ANGLES)]
    return torch.tensor(entropies, dtype=torch.float64)


def _entropy(values: np.ndarray) -> float:
    margin = (1 - CENTRAL_FRACTION) / 2
    low, high = np.quantile(values, [margin, 1 - margin])
    values = values[(values >= low) & (values <= high)]
    width = 3.5 * values.std() * len(values) ** (-1 / 3)
    if not width > 0:
        return 0.0
    counts = np.bincount(((values - low) / width).astype(np.int64))
    frequencies = counts[counts > 0] / len(values)
    return float(-(frequencies * np.log2(frequencies)).sum())


def invariant_angle(entropies: Tensor) -> float:
    """Return the angle of least entropy in degrees, from (180,) of an image or a camera's mean."""
    return float(entropies.argmin())


def histogram_likelihood(plane: Tensor, seed: Tensor) -> Tensor:
    """Compute p(value | road) / max p of a plane (H, W), by its histogram in the seed (H, W)."""
    low, high = (float(bound) for bound in plane.aminmax())
    bins = quantise_plane(plane, MODEL_BINS, low, high)
    counts = torch.bincount(bins[seed], minlength=MODEL_BINS).to(plane)
    kernel = plane.new_tensor(MODEL_SMOOTHING)[None, None]
    smooth = torch.nn.functional.conv1d(counts[None, None], kernel, padding=1)[0, 0]
    return (smooth / smooth.max().clamp_min(1e-6))[bins]
