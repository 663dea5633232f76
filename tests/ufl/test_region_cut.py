"""Regions, their bags of words, and the cut between road and the rest."""

from itertools import product

import pytest
import torch
from torch import Tensor

from roadtorch.ufl.region_cut import (
    CutSettings,
    bags_of_words,
    connected_regions,
    cut_road,
    shared_borders,
    source_side,
)

CLUSTERS = torch.tensor([[0, 0, 1, 0], [2, 2, 1, 0], [2, 2, 1, 0]])


def test_pieces_of_one_cluster_are_regions_of_their_own() -> None:
    found = connected_regions(CLUSTERS)

    assert found[0, 0] == found[0, 1] != found[0, 3]
    assert found[0, 3] == found[2, 3]
    assert found.unique().tolist() == [0, 1, 2, 3]


def test_bags_count_the_words_of_each_region() -> None:
    regions = torch.tensor([[0, 0, 1], [0, 1, 1]])
    words = torch.tensor([[2, 2, 0], [1, 0, 2]])

    assert bags_of_words(regions, words, 3).tolist() == [[0, 1, 2], [2, 0, 1]]


def test_borders_are_counted_in_pixels() -> None:
    pairs, length = shared_borders(torch.tensor([[0, 0, 1], [2, 2, 1]]))

    found = dict(zip(map(tuple, pairs.tolist()), length.tolist(), strict=True))
    assert found == {(0, 1): 1, (0, 2): 2, (1, 2): 1}


def cost(chosen: tuple[bool, ...], source: Tensor, sink: Tensor, edges: Tensor, between: Tensor):
    """What a partition cuts, by its definition."""
    apart = sum(
        weight for (one, two), weight in zip(edges.tolist(), between.tolist(), strict=True)
        if chosen[one] != chosen[two]
    )  # fmt: skip
    return apart + sum(
        float(sink[node] if mine else source[node]) for node, mine in enumerate(chosen)
    )


@pytest.mark.parametrize("seed", range(8))
def test_no_other_partition_is_cheaper(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    source, sink = torch.rand(2, 6, generator=generator)
    edges = torch.tensor([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [0, 5], [1, 4]])
    between = torch.rand(7, generator=generator)

    found = tuple(source_side(source, sink, edges, between).tolist())

    least = min(cost(one, source, sink, edges, between) for one in product((False, True), repeat=6))
    assert cost(found, source, sink, edges, between) == pytest.approx(least, abs=0.02)


def test_road_is_what_looks_like_the_seed_more_than_like_the_top() -> None:
    regions = torch.zeros(9, 6, dtype=torch.int64)
    regions[3:6], regions[6:] = 1, 2
    words = torch.tensor([0, 1, 1])[regions]
    seed = torch.zeros(9, 6, dtype=torch.bool)
    seed[8, 2:4] = True

    found = cut_road(regions, words, 2, seed, CutSettings())

    assert found.int()[:, 0].tolist() == [0] * 3 + [1] * 6


def test_where_borders_are_dear_an_island_in_the_road_is_road() -> None:
    regions = torch.zeros(9, 6, dtype=torch.int64)
    regions[3:] = 2
    regions[5:7, 2:4] = 1
    words = regions.clone()
    words[5:7, 2:4] = torch.tensor([[0, 0], [0, 2]])  # more like the top than like the road
    seed = torch.zeros(9, 6, dtype=torch.bool)
    seed[8] = True

    cheap, dear = (cut_road(regions, words, 3, seed, CutSettings(border=b)) for b in (0.0, 50.0))

    assert cheap[8, 0]
    assert not cheap[5, 2]
    assert dear[8, 0]
    assert dear[5, 2]


def test_a_picture_of_one_region_has_no_road() -> None:
    regions = torch.zeros(5, 5, dtype=torch.int64)

    assert not cut_road(regions, regions, 1, regions == 0, CutSettings()).any()
