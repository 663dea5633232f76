"""Clusters around density peaks, regions, their bags of words, and the graph cut."""

from itertools import product

import pytest
import torch
from torch import Tensor

from roadtorch.ufl.region_cut import (
    CutSettings,
    PeakSettings,
    cluster_pixels,
    connected_regions,
    cut_road,
    source_side,
)
from tests.draws import random


def test_components_of_a_cluster_are_separate_regions() -> None:
    regions = connected_regions(torch.tensor([[0, 0, 1, 0], [2, 2, 1, 0], [2, 2, 1, 0]]))

    assert regions[0, 0] == regions[0, 1] != regions[0, 3]
    assert regions[0, 3] == regions[2, 3]
    assert regions.unique().tolist() == [0, 1, 2, 3]
    assert connected_regions(torch.eye(2)).unique().tolist() == [0, 1, 2, 3]  # not by corners


@pytest.mark.parametrize("seed", range(8))
def test_no_other_partition_is_cheaper(seed: int) -> None:
    source, sink = random(2, 6, seed=seed)
    edges = torch.tensor([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [0, 5], [1, 4]])
    between = random(7, seed=seed + 100)

    def cost(chosen: Tensor) -> float:
        """Return the cost of a partition by its definition."""
        apart = chosen[edges[:, 0]] != chosen[edges[:, 1]]
        return float(torch.where(chosen, sink, source).sum() + between[apart].sum())

    side = source_side(source, sink, edges, between)

    least = min(cost(torch.tensor(chosen)) for chosen in product((False, True), repeat=6))
    assert cost(side) == pytest.approx(least, abs=0.02)


def test_with_expensive_borders_an_island_in_the_road_is_road() -> None:
    regions = torch.zeros(9, 6, dtype=torch.int64)
    regions[3:] = 2
    regions[5:7, 2:4] = 1
    words = regions.clone()
    words[5:7, 2:4] = torch.tensor([[0, 0], [0, 2]])  # more like the top than like the road
    seed = torch.zeros(9, 6, dtype=torch.bool)
    seed[8] = True

    cheap, dear = (
        cut_road(regions, words, 3, seed, CutSettings(border_cost=b)) for b in (0.0, 50.0)
    )

    for mask, is_road in ((cheap, False), (dear, True)):
        assert mask[5, 2] == is_road
        assert mask[8, 0]
        assert not mask[0, 0]


# --- clusters ---------------------------------------------------------------------------


def test_pixels_belong_to_the_nearest_peak() -> None:
    half = torch.cat([torch.zeros(6, 5), torch.ones(6, 5)], 1)
    noise = random(2, 6, 10, seed=1) * 0.1

    clusters = cluster_pixels(torch.stack([half, 1 - half]) + noise, PeakSettings(clusters=2))

    assert clusters.shape == (6, 10)
    assert len(clusters[:, :5].unique()) == len(clusters[:, 5:].unique()) == 1
    assert int(clusters[0, 0]) != int(clusters[0, 9])
