"""Clusters around peaks of density."""

import torch
from torch import Tensor

from roadtorch.ufl.density_peaks import PeakSettings, cluster_pixels, density_peaks


def blobs(*centres: float, each: int = 40, spread: float = 0.05) -> Tensor:
    """Points (n,2) around places on the diagonal."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(len(centres), each, 2, generator=generator) * spread
    return (torch.tensor(centres)[:, None, None] + noise).view(-1, 2)


def test_every_blob_has_its_peak() -> None:
    peaks = density_peaks(blobs(0.0, 1.0, 3.0), 3, 0.02)

    assert sorted((peaks // 40).tolist()) == [0, 1, 2]


def test_the_densest_point_is_a_peak_however_near_the_others_are() -> None:
    points = torch.tensor([[0.0], [0.1], [0.2], [0.3], [1.0]])

    assert int(density_peaks(points, 1, 0.3)[0]) in (1, 2)


def test_points_that_are_all_the_same_have_peaks_all_the_same() -> None:
    assert len(density_peaks(torch.zeros(20, 3), 4, 0.02)) == 4


def test_pixels_belong_to_the_nearest_peak() -> None:
    half = torch.cat([torch.zeros(6, 5), torch.ones(6, 5)], 1)
    noise = torch.rand(2, 6, 10, generator=torch.Generator().manual_seed(1)) * 0.1

    found = cluster_pixels(torch.stack([half, 1 - half]) + noise, PeakSettings(clusters=2))

    assert found.shape == (6, 10)
    assert len(found[:, :5].unique()) == len(found[:, 5:].unique()) == 1
    assert int(found[0, 0]) != int(found[0, 9])
