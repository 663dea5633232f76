"""Clusters around peaks of density, for Xia et al.'s roads.

Rodriguez and Laio, "Clustering by fast search and find of density peaks", Science 344, 2014.
"""

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.settings import Settings


class PeakSettings(Settings):
    """How many clusters, of which samples."""

    clusters: int = Field(default=8, ge=2, le=100, description="peaks of density that are kept")
    samples: int = Field(
        default=1000, ge=10, le=10_000, description="pixels, evenly spread, among which they are"
    )
    neighbours: float = Field(
        default=0.02, gt=0, le=1, description="share of all pairs that counts as near"
    )


def density_peaks(points: Tensor, clusters: int, neighbours: float) -> Tensor:
    """Which of n points (n,d) are the peaks: int64 (k,), k ≤ clusters, the clearest first.

    Density is a sum of Gaussians of the distances, their width the quantile ``neighbours`` of
    all; a point's other figure is its distance to the nearest one that is denser. Peaks are where
    the product of both is greatest.
    """
    far = torch.cdist(points, points)
    width = far.flatten().kthvalue(max(1, round(neighbours * far.numel()))).values
    density = (-(far / width.clamp_min(torch.finfo(far.dtype).tiny)).square()).exp().sum(1)
    order = density.argsort(descending=True, stable=True)
    rank = order.argsort()
    denser = rank < rank[:, None]  # in row i the points that are denser than i
    apart = far.masked_fill(~denser, torch.inf).amin(1)
    apart[order[0]] = far[order[0]].amax()
    return (density * apart).argsort(descending=True, stable=True)[:clusters]


def cluster_pixels(features: Tensor, settings: PeakSettings) -> Tensor:
    """The cluster of every pixel, int64 (H,W): that of the nearest peak; features: (m,H,W).

    Xia et al. follow the chain of denser neighbours through all pixels; ours looks for peaks
    among a sample, for the distances of all pairs of 17,825 pixels take gigabytes.
    """
    pixels = features.flatten(1).T
    step = max(1, len(pixels) // settings.samples)
    sample = pixels[::step]
    peaks = sample[density_peaks(sample, settings.clusters, settings.neighbours)]
    return torch.cdist(pixels, peaks).argmin(1).view(features.shape[1:])
