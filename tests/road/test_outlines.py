"""Outlines that follow the image, and the trust in a mask."""

import pytest
import torch
from torch import Tensor

from roadtorch.imaging.resize import WorkingSize, resize_maps, resize_to_work, spatial_size
from roadtorch.layout.classes import VERTICAL
from roadtorch.road.ego import extrapolate_over_ego
from roadtorch.road.outlines import HOLE_MARGIN, fill_thin_holes, guided_filter, snap_to_edges
from roadtorch.road.trust import (
    DOUBT_REASONS,
    FEATURE_WEIGHTS,
    INTERCEPT,
    MEAN_FEATURES,
    NO_ROAD,
    TrustFeatures,
    TrustSettings,
    estimate_trust,
    trust_features,
)


def halves(height: int, width: int) -> Tensor:
    """Two colours and a slanted line between: (3,H,W)."""
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    side = (column / width + 0.3 * row / height > 0.6).float()
    colour = torch.tensor([0.3, 0.1, -0.2])[:, None, None]
    return (0.4 + colour * side).clamp(0, 1)


def test_stairs_become_the_line_that_the_image_has() -> None:
    image, small = halves(480, 640), resize_maps(halves(480, 640), (180, 240))
    road = image[0] > 0.5
    stairs = small[0, 6::12, 6::12].repeat_interleave(12, 0).repeat_interleave(12, 1)
    likelihood = 0.1 + 0.8 * (stairs > 0.5)

    wrong = (resize_maps(likelihood, (480, 640)) > 0.5) != road
    still = (guided_filter(likelihood, small, image) > 0.5) != road

    assert still.sum() < wrong.sum() / 10


def test_what_is_an_affine_function_of_colour_stays_itself() -> None:
    image = resize_maps(
        torch.rand(3, 15, 20, generator=torch.Generator().manual_seed(0)), (120, 160)
    )
    function = 0.2 + 0.3 * image[0] + 0.4 * image[2]

    refined = guided_filter(function, image, image)

    assert (refined - function).abs().max() < 0.06  # the ridge flattens it a little


def test_what_the_ego_car_map_leaves_of_a_bonnet_like_the_road_stays_no_road() -> None:
    working, begins, missed = WorkingSize(pixels=256 * 192), 400, 4
    noise = torch.randn(3, 480, 640, generator=torch.Generator().manual_seed(0))
    level = torch.where(torch.arange(480)[:, None] < begins, 0.5, 0.4)
    image = (level + 0.04 * noise).clamp(0, 1)
    small = resize_to_work(image, working)
    below = (torch.arange(len(small[0]))[:, None] + 0.5) * 480 / len(small[0]) - begins
    below = below.expand(spatial_size(small))
    ego = below > missed
    likelihood = extrapolate_over_ego(0.9 - 0.8 * (below / 12 + 0.5).clamp(0, 1), ego)

    refined = snap_to_edges({"likelihood": likelihood, "ego": ego}, small, image, 0.5)

    assert (refined[begins : begins + missed] > 0.5).double().mean() < 0.05
    assert (refined[: begins - 12] > 0.5).double().mean() > 0.99


@pytest.mark.parametrize(("vertical", "is_road"), [(0.2, True), (0.4, False)])
def test_edges_add_no_road_where_something_stands(vertical: float, is_road: bool) -> None:
    post = slice(30, 32)
    image = torch.full((3, 64, 64), 0.5)  # the post looks like the road
    likelihood = torch.full((64, 64), 0.9)
    likelihood[:, post] = 0.4
    layout = torch.zeros(3, 64, 64)
    layout[VERTICAL, :, post] = vertical

    refined = snap_to_edges({"likelihood": likelihood, "layout": layout}, image, image, 0.5)

    assert bool((refined[:, post] >= 0.5).all()) is is_road
    assert bool((refined[:, post] >= 0.5).any()) is is_road


ROAD_LEVEL, OTHER_LEVEL = 0.8, 0.1


@pytest.mark.parametrize(
    ("hole", "is_filled"),
    [
        ((slice(60, 110), slice(80, 83)), True),  # a line
        ((slice(60, 110), slice(80, 130)), False),  # a car
        ((slice(100, 120), slice(80, 83)), True),  # a line that leaves the image
        ((slice(20, 110), slice(80, 83)), False),  # what is thin and joins the background
    ],
)
def test_thin_holes_are_road_by_one_byte_level(hole: tuple[slice, slice], is_filled: bool) -> None:
    likelihood = torch.full((120, 320), OTHER_LEVEL)
    likelihood[40:] = ROAD_LEVEL
    likelihood[hole] = OTHER_LEVEL
    expected = likelihood.clone()
    expected[hole] = 0.5 + HOLE_MARGIN if is_filled else OTHER_LEVEL

    assert torch.equal(fill_thin_holes(likelihood, 0.5), expected)


# --- trust ------------------------------------------------------------------------------


NOWHERE = torch.zeros(20, 20, dtype=torch.bool)
EGO = NOWHERE.clone()
EGO[15:] = True
ROAD = torch.zeros(20, 20)
ROAD[:, :10] = 1  # over the left half
UNSURE_ABOVE, UNSURE_BELOW = ROAD.clone(), ROAD.clone()
UNSURE_ABOVE[:5], UNSURE_BELOW[15:] = 0.5, 0.5
BEST = TrustFeatures(stability=1, expected=1, entropy=0)


def signs(
    likelihood: Tensor = ROAD,
    mask: Tensor = ROAD > 0.5,
    ego: Tensor = NOWHERE,
) -> TrustFeatures:
    return trust_features(likelihood, mask, ego)


def test_the_signs_of_a_mask_tell_what_is_wrong_with_it() -> None:
    assert signs() == pytest.approx(BEST, abs=1e-6)
    # A quarter of the image, a hundred pixels of it at the low threshold, is undecided: of the
    # 200 pixels of the mask 175 are road, and 50 beside it.
    undecided = BEST._replace(stability=150 / 250, entropy=0.25, expected=2 * 175 / (200 + 200))
    assert signs(likelihood=UNSURE_ABOVE) == pytest.approx(undecided, abs=1e-6)
    assert signs(mask=~NOWHERE).expected == pytest.approx(2 * 200 / (400 + 200))
    assert signs(likelihood=UNSURE_BELOW, ego=EGO) == signs(ego=EGO)  # the ego car is not asked
    assert all(0 <= sign <= 5 for sign in signs(0.6 - 0.2 * ROAD, NOWHERE))  # an empty mask


def test_better_signs_are_trusted_more_and_usual_ones_without_a_doubt() -> None:
    best = estimate_trust(BEST, True, TrustSettings())
    usual = estimate_trust(MEAN_FEATURES, True, TrustSettings())
    worst = estimate_trust(TrustFeatures(0, 0, 0), True, TrustSettings())

    assert 0 <= worst.trust < usual.trust < best.trust <= 1  # better, and in its range
    assert usual.doubt == ""
    assert worst.doubt in DOUBT_REASONS
    linear = INTERCEPT + sum(
        weight * sign for weight, sign in zip(FEATURE_WEIGHTS, MEAN_FEATURES, strict=True)
    )
    assert usual.trust == pytest.approx(linear)
    assert estimate_trust(BEST, False, TrustSettings()) == (0.0, "no road found")


def test_where_all_is_in_doubt_there_is_no_road() -> None:
    judged = estimate_trust(
        TrustFeatures(stability=0.1, expected=0.8, entropy=0.8), True, TrustSettings()
    )

    assert judged.trust < 0.3
    assert judged.doubt == NO_ROAD


@pytest.mark.parametrize("number", [n for n, weight in enumerate(FEATURE_WEIGHTS) if weight])
def test_the_reason_is_the_sign_that_is_worse_than_usual(number: int) -> None:
    wrong = list(MEAN_FEATURES)
    wrong[number] = 0.0

    judged = estimate_trust(TrustFeatures(*wrong), True, TrustSettings(threshold=1.0))

    assert judged.doubt == DOUBT_REASONS[number]
    assert judged.trust < estimate_trust(MEAN_FEATURES, True, TrustSettings()).trust
