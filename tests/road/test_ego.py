"""The ego car of the settings and of a network: masks, refusals, and extrapolated ground."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import write_mask
from roadtorch.detectors.catalogue import load_detector
from roadtorch.road.ego import (
    MIN_FILL,
    MIN_FREE,
    Ego,
    ego_car,
    extrapolate_over_ego,
    find_ego_car,
    outline_rows,
)
from tests.streets import bonnet, scene


def mask_file(folder: Path, mask: Tensor) -> str:
    write_mask(folder / "ego.png", mask)
    return str(folder / "ego.png")


# --- where it is ----------------------------------------------------------------------------


def test_the_bottom_is_a_share_of_the_height() -> None:
    car = ego_car(torch.zeros(3, 50, 20), Ego(bottom=0.16))

    assert car.sum(0).tolist() == [8] * 20
    assert car[-8:].all()


def test_an_outline_is_straight_between_the_middles_of_its_columns() -> None:
    assert outline_rows((0.5, 1.0), 4).tolist() == pytest.approx([0.5, 0.625, 0.875, 1.0])
    assert outline_rows((0.7,), 3).tolist() == pytest.approx([0.7] * 3)
    assert not ego_car(torch.zeros(3, 40, 30), Ego(outline=(1.0, 1.0))).any()  # one is none


def test_what_any_of_the_three_says_counts(tmp_path: Path) -> None:
    pillar = torch.zeros(40, 60, dtype=torch.bool)
    pillar[:, :5] = True
    file = mask_file(tmp_path, pillar)

    car = ego_car(torch.zeros(3, 40, 60), Ego(bottom=0.1, outline=(1, 1, 1, 0.5), mask=file))

    expected = pillar.clone()
    expected[-4:] = True
    expected[20:, -7:] = True  # the last column's middle, and right of it
    assert (car | expected).equal(car)
    assert not car[:36, 5:35].any()


def test_the_mask_is_read_once_for_all_images(tmp_path: Path) -> None:
    file = mask_file(tmp_path, bonnet(30, 40))
    detector = load_detector("prior:rows", ego={"mask": file})
    Path(file).unlink()

    for seed in range(2):
        assert torch.equal(detector.detect(scene(seed, 30, 40).image).cues["ego"], bonnet(30, 40))


# --- what is refused ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (
            lambda folder: ego_car(
                torch.zeros(3, 60, 80), Ego(mask=mask_file(folder, bonnet(30, 40)))
            ),
            r"image: is 80×60 pixels, but the ego mask .*ego.png is 40×30",
        ),
        (
            lambda folder: load_detector(
                "prior:rows", ego={"mask": mask_file(folder, torch.ones(30, 40) > 0)}
            ),
            r"ego\.png: marks nearly every pixel",
        ),
        (
            lambda _: ego_car(torch.zeros(3, 9, 9), Ego(bottom=0.85, outline=(0.0, 0.0, 1.0))),
            "image: is almost completely covered",
        ),
        (
            lambda _: load_detector("prior:rows", ego={"outline": (0.01, 0.05)}),
            "ego.outline: .*leave at least 10% of the image free",
        ),
    ],
)
def test_nonsense_is_refused(call: Callable[[Path], object], problem: str, tmp_path: Path) -> None:
    with pytest.raises((ConfigError, InputError), match=problem):
        call(tmp_path)


# --- ground in its place --------------------------------------------------------------------


def slowly_continued(column: list[float], car: list[bool]) -> list[float]:
    """One column whose top is free, pixel by pixel: a mirror that walks up and down its strip."""
    strip = max(1, round(0.08 * len(column)))
    made = list(column)
    for row in range(len(column)):
        if not car[row]:
            continue
        edge = row
        while car[edge]:
            edge -= 1
        run = 1
        while run < strip and edge - run >= 0 and not car[edge - run]:
            run += 1
        walk = [*range(run), *range(run - 1, -1, -1)]
        made[row] = column[edge - walk[(row - edge - 1) % len(walk)]]
    return made


@given(st.lists(st.booleans(), min_size=20, max_size=40))
def test_a_column_is_mirrored_again_and_again(car: list[bool]) -> None:
    car = [False, *car]
    column = [float(value) for value in range(len(car))]
    maps = torch.tensor(column).view(1, -1, 1).expand(1, -1, 3)

    made = extrapolate_over_ego(maps, torch.tensor(car)[:, None].expand(-1, 3))

    assert made[0, :, 1].tolist() == slowly_continued(column, car)


# --- detectors ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["fusion", "cpf", "oneclass:kmeans:HS", "prior:rows"])
def test_no_pixel_of_the_ego_car_changes_anything(name: str) -> None:
    image = scene(3, 120, 160).image
    outline = tuple((~bonnet(120, 160)).double().mean(0).tolist())
    detector = load_detector(name, ego={"outline": outline}, threshold=0.0)
    car = ego_car(image, detector.settings.ego)

    black, white = (detector.detect(torch.where(car, paint, image)) for paint in (0.0, 1.0))

    assert black.likelihood.equal(white.likelihood)
    assert black.cues["ego"][car].all()  # a detector may see more of it
    assert not black.mask[car].any()
    assert not black.likelihood[car].any()
    assert black.mask.any()


def test_road_that_reaches_the_ego_car_is_not_isolated() -> None:
    """Its seed area is hidden: only a little of the road touches what is left of the rectangle."""
    car = {"bottom": 0.25}  # twice as high as the seed area

    detection = load_detector("fusion", ego=car).detect(scene(3).image)

    assert detection.mask[150:175, 120:200].float().mean() > 0.9


# --- found in the image -------------------------------------------------------------------

HEIGHT, WIDTH = 40, 60
EVERY = slice(None)
BONNET = (slice(30, None), EVERY)
SIDE = (slice(20, None), slice(0, 15))
AHEAD = (slice(14, 18), slice(25, 35))
NEARLY_ALL = slice(HEIGHT - round(HEIGHT * (1 - MIN_FREE)) - 1, None)


def potential(*parts: tuple[slice, slice], high: float = 0.9, low: float = 0.1) -> Tensor:
    """High in the given rows and columns, low elsewhere."""
    values = torch.full((HEIGHT, WIDTH), low)
    for rows, columns in parts:
        values[rows, columns] = high
    return values


LIT = potential(BONNET)
LIT[33:36, 20:30] = 0.2


@pytest.mark.parametrize(
    ("evidence", "car"),
    [
        pytest.param(potential(BONNET), [BONNET], id="down to the lower edge"),
        pytest.param(LIT, [BONNET], id="light on it leaves no hole"),
        pytest.param(potential(AHEAD), [], id="a car ahead is none"),
        # From the car's upper edge down, 14 of 26 rows are likelier ego car than not.
        pytest.param(potential(AHEAD, BONNET), [BONNET], id="and takes nothing from it"),
        pytest.param(potential(SIDE), [SIDE], id="at one side, in its columns alone"),
        pytest.param(potential((EVERY, EVERY)), [], id="everywhere"),
        pytest.param(potential((NEARLY_ALL, EVERY)), [], id="nearly everywhere"),
        pytest.param(potential(BONNET, high=0.55), [], id="half believed"),
        pytest.param(potential(BONNET, high=0.85), [BONNET], id="believed"),
        pytest.param(potential(low=0.5), [], id="undecided"),
        # The larger, the surer it has to be.
        pytest.param(0.85 * potential((slice(37, None), EVERY)), [(slice(37, None), EVERY)]),
        pytest.param(0.85 * potential((slice(20, None), EVERY)), []),
    ],
)
def test_the_ego_car_reaches_the_lower_edge(
    evidence: Tensor, car: list[tuple[slice, slice]]
) -> None:
    assert torch.equal(find_ego_car(evidence), potential(*car) > 0.5)


@given(st.integers(0, 2**31), st.floats(0.1, 0.9))
def test_each_column_is_free_above_and_solid_ego_car_below(seed: int, level: float) -> None:
    at = torch.Generator().manual_seed(seed)
    rough = torch.rand(12, 16, generator=at) + (torch.arange(12)[:, None] / 12 - 0.5) * level

    car = find_ego_car(rough.clamp(0, 1))

    assert (car.int().diff(dim=0) >= 0).all()
    for column in car.any(0).nonzero()[:, 0].tolist():
        first = int(car[:, column].int().argmax())
        assert rough[first, column] > 0.5
        assert (rough[first:, column] > 0.5).float().mean() >= MIN_FILL
