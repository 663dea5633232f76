"""The tree of regions and the choice among its nodes."""

from typing import Literal

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.ufl import hierarchy
from tests.draws import random, seeded
from tests.reference import ufl as reference

STEPS = hierarchy.thresholds(6, "included")


def bumpy(seed: int) -> torch.Tensor:
    """A map with hills, some values exactly on the thresholds, and a maximum of 1."""
    smooth = torch.nn.functional.avg_pool2d(random(1, 9, 11, seed=seed), 3, 1, 1)[0]
    return ((smooth / smooth.max() * 12).round() / 12).clamp(0, 1)


def stable(seed: int) -> torch.Tensor:
    return torch.randn(9, 11, generator=seeded(seed), dtype=torch.float64)


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_regions_are_the_components_of_every_level_in_reading_order(seed: int) -> None:
    values = bumpy(seed)

    found = hierarchy.threshold_regions(values, STEPS)

    number = 1
    assert (found.labels[0] == 1).all()
    for level, step in enumerate(STEPS.tolist()[1:], 1):
        for pixels in reference.components(values.numpy() >= step):
            number += 1
            rows, columns = zip(*sorted(pixels), strict=True)
            assert (found.labels[level][rows, columns] == number).all()
            assert (found.level[number], found.area[number]) == (level, len(pixels))
            assert found.parent[number] == found.labels[level - 1][rows[0], columns[0]]
    assert len(found.area) == number + 1


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 12))
def test_the_chosen_road_is_that_of_the_paper_step_by_step(seed: int, least: int) -> None:
    values = bumpy(seed)
    pixels = stable(seed)

    tree = hierarchy.build_tree(hierarchy.threshold_regions(values, STEPS), least)
    choice = hierarchy.select_nodes(tree, hierarchy.node_stability(tree, pixels))

    root = reference.tree(values.numpy(), STEPS.tolist(), least)
    expected = reference.road(root, pixels.numpy())
    assert np.array_equal(hierarchy.selected_area(tree, choice.selected).numpy(), expected)
    if root.children:
        total = sum(reference.optimise(child, pixels.numpy())[0] for child in root.children)
        assert float(choice.best[0]) == pytest.approx(total)


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_single_regions_are_worth_at_least_as_much_as_runs(seed: int) -> None:
    """Every first region of a run is among the regions, so their best sum is no smaller."""
    values = bumpy(seed)
    pixels = stable(seed)
    regions = hierarchy.threshold_regions(values, STEPS)

    def worth(nodes: hierarchy.Nodes) -> float:
        tree = hierarchy.build_tree(regions, 4, nodes)
        choice = hierarchy.select_nodes(tree, hierarchy.node_stability(tree, pixels), "never")
        return float(pixels[hierarchy.selected_area(tree, choice.selected)].sum())

    assert worth("regions") >= worth("runs") - 1e-9


@pytest.mark.parametrize(
    ("value", "whole", "road", "best"),
    [
        # Six levels above the first, which does not count.
        (1.0, "if_undivided", True, 6),
        (1.0, "never", False, 0),
        (0.0, "if_undivided", False, 0),
    ],
)
def test_the_whole_map_is_road_only_where_nothing_splits_and_only_if_allowed(
    value: float, whole: Literal["if_undivided", "never"], road: bool, best: float
) -> None:
    values = torch.full((6, 6), value, dtype=torch.float64)
    tree = hierarchy.build_tree(hierarchy.threshold_regions(values, STEPS), 4)

    choice = hierarchy.select_nodes(tree, hierarchy.node_stability(tree, torch.ones(6, 6)), whole)

    assert choice.selected.tolist() == [road]
    assert choice.best.tolist() == [best]
