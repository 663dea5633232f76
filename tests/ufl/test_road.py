"""The tree of regions and the choice of its nodes; the road, and its conversion to image size."""

from typing import Literal

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.ufl import hierarchy, road
from roadtorch.ufl.road import StabilitySettings
from tests.draws import random, seeded_generator
from tests.reference import ufl as reference


def lower_half() -> torch.Tensor:
    mask = torch.zeros(9, 12, dtype=torch.bool)
    mask[5:, 3:9] = True
    return mask


# Place


def test_position_weights_are_0_on_the_sides_of_the_triangle() -> None:
    weights = road.triangle_position_weights(100, 200, apex=0.5, base=0.8)

    assert (weights[:50] == -1).all()
    assert float(weights[-1, 99]) > 0.98
    inside = (weights > 0).sum(1)
    assert abs(int(inside[-1]) - 0.8 * 200) <= 2
    assert abs(int(inside[74]) - 0.4 * 200) <= 4
    np.testing.assert_allclose(weights, weights.flip(1))


# Reconstruction error (eq. 10)


@pytest.mark.parametrize("centring", ["road", "none"])
@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), fraction=st.floats(0.3, 0.99))
def test_the_error_is_equation_10(centring: road.Centring, seed: int, fraction: float) -> None:
    maps = random(5, 9, 12, seed=seed)

    error = road.reconstruction_error(maps, lower_half(), centring, fraction)

    expected = reference.errors(maps.numpy(), lower_half().numpy(), fraction, centring == "road")
    np.testing.assert_allclose(error.numpy(), expected, atol=1e-7)


# The two loops


def street() -> tuple[torch.Tensor, torch.Tensor]:
    """Return maps (6, 30, 40) and their mean: a road that varies, a wall with other features."""
    maps = torch.zeros(6, 30, 40, dtype=torch.float64)
    maps[:, 16:, 8:32] = torch.linspace(0.9, 1, 24, dtype=torch.float64)
    maps[:4, 6:16, 8:32] = 0.9
    return maps, maps.mean(0) / maps.mean(0).max()


def run(maps: torch.Tensor, mean: torch.Tensor, **settings: object) -> list[road.Round]:
    regions = hierarchy.threshold_regions(mean, hierarchy.region_thresholds(16, "included"))
    tree = hierarchy.build_tree(regions, 10, "regions")
    return road.find_road(maps, mean, tree, StabilitySettings.model_validate(settings))


def test_the_first_round_has_no_error_and_the_next_find_the_road_without_the_wall() -> None:
    rounds = run(*street(), rounds=3, position="ahead")

    assert len(rounds) == 3
    assert (rounds[0].error == 0).all()
    assert float(rounds[1].error.max()) == 1
    assert rounds[1].error[20:, 10:30].mean() < rounds[1].error[8:14, 10:30].mean()
    assert rounds[1].road[17:, 9:31].all()
    assert not rounds[1].road[:15].any()


# Back to the image


@pytest.mark.parametrize("side", [2, 5, 6, 7])
def test_maps_are_converted_to_the_size_of_the_image(side: int) -> None:
    values = random(9, 12)

    enlarged = road.map_to_image(values, side)

    assert enlarged.shape == road.mask_to_image(values > 0.5, side).shape == (8 + side, 11 + side)
    assert (
        float(values.min()) <= float(enlarged.min()) <= float(enlarged.max()) <= float(values.max())
    )
    ramp = torch.arange(12.0).expand(9, 12)
    assert float(road.map_to_image(ramp, side)[4, 6]) == 6 - (side - 1) / 2


# --- the tree ---------------------------------------------------------------------------


STEPS = hierarchy.region_thresholds(6, "included")


def bumpy(seed: int) -> torch.Tensor:
    """Return a map with hills, values exactly on the thresholds, and a maximum of 1."""
    smooth = torch.nn.functional.avg_pool2d(random(1, 9, 11, seed=seed), 3, 1, 1)[0]
    return ((smooth / smooth.max() * 12).round() / 12).clamp(0, 1)


def stable(seed: int) -> torch.Tensor:
    return torch.randn(9, 11, generator=seeded_generator(seed), dtype=torch.float64)


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
