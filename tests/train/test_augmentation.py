"""Augmentation of whole images: geometry, light, weather; ego cars pasted over streets."""

import math
import random
from collections import Counter
from pathlib import Path

import pytest
import torch
from torch import Tensor

from roadtorch.run.memo import write_arrays
from roadtorch.train.augmentation import (
    EgoCar,
    EgoCarAugmentation,
    GeometryAugmentation,
    LightAugmentation,
    NightAugmentation,
    SceneMasks,
    ShadowAugmentation,
    SurfaceAugmentation,
    WeatherAugmentation,
    add_fog,
    add_rain,
    add_shadow,
    add_snow,
    darken_to_night,
    jitter_ego_car,
    jitter_light,
    paste_ego_car,
    retexture_road,
    sample_affine,
    sample_ego_cars,
    warp_affine,
    wet_road,
)
from roadtorch.train.teachers import TARGET_PLANES, Targets
from tests.draws import seeded_generator
from tests.streets import scene

STILL = GeometryAugmentation(scale=0, stretch=0, rotation=0, translation=0)


def sides(images: list[Tensor], expected: Tensor, atol: float = 1e-5) -> list[int]:
    """Return for each image 1 where it is as expected, -1 where it is mirrored, else 0."""
    return [
        int(image.allclose(expected, atol=atol)) - int(image.allclose(expected.flip(-1), atol=atol))
        for image in images
    ]


# --- frames --------------------------------------------------------------------------------


@pytest.mark.parametrize(("mirror", "signs"), [(0.0, {1}), (1.0, {-1}), (0.5, {-1, 1})])
def test_without_shift_a_frame_is_the_image_or_its_mirror_image(
    mirror: float, signs: set[int]
) -> None:
    maps = torch.rand(2, 9, 12, generator=seeded_generator(1))
    geometry = STILL.model_copy(update={"mirror": mirror})
    frames = sample_affine(9, (9, 12), geometry, seeded_generator(2))
    images = warp_affine(maps.expand(9, -1, -1, -1), frames, "border")
    assert set(sides(list(images), maps)) == signs


def test_of_a_lower_part_the_bottom_stays_and_the_top_goes() -> None:
    rows = torch.linspace(0, 1, 80)[None, None, :, None].expand(8, 1, 80, 60)

    frames = sample_affine(
        8, (80, 60), GeometryAugmentation(crop_probability=1.0, max_crop=0.5), seeded_generator(5)
    )
    images = warp_affine(rows, frames, "border")

    assert torch.allclose(images[:, 0, -1], torch.ones(8, 60), atol=0.02)
    assert ((images[:, 0, 0] >= -0.01) & (images[:, 0, 0] <= 0.51)).all()
    assert images[:, 0, 0].max() > 0.2
    assert frames[:, 0, 0].abs().max() <= 1  # nothing beside the image is seen


# --- light ---------------------------------------------------------------------------------


def test_light_changes_the_image_and_stays_in_range() -> None:
    images = torch.stack([scene(seed, 60, 80).image for seed in range(4)])
    lit = jitter_light(images, LightAugmentation(), seeded_generator(3))
    assert 0 <= lit.min() <= lit.max() <= 1
    assert ((lit - images).abs().mean((1, 2, 3)) > 0.01).all()
    none = LightAugmentation(gamma=0, gain=0, tint=0, saturation=0, noise=0)
    torch.testing.assert_close(
        jitter_light(images, none, seeded_generator(3)), images, atol=1e-4, rtol=0
    )


def test_at_night_the_road_ahead_is_lit_and_the_ego_car_is_dark() -> None:
    day, unlit = torch.full((1, 3, 80, 60), 0.8), torch.zeros(1, 1, 80, 60)
    unlit[..., 70:, :] = 1
    settings = NightAugmentation(min_brightness=0.05, lamps=0)

    nights = [darken_to_night(day, unlit, settings, seeded_generator(seed)) for seed in range(12)]

    for night in nights:
        assert night[..., 44:66, 24:36].amax() > 2 * night[..., :20, :].amax()
        assert night[..., 70:, :].amax() <= 0.8 * 0.3 * 1.3 + 1e-6
    assert len({float(night.mean()) for night in nights}) == len(nights)


def street() -> tuple[torch.Tensor, SceneMasks]:
    """Return blue sky above row 40, a grey road between green, and an ego car from row 72 on."""
    image, ground, road, ego = torch.zeros(1, 3, 80, 64), *(torch.zeros(3, 1, 1, 80, 64))
    ground[..., 40:72, :] = road[..., 40:72, 24:40] = ego[..., 72:, :] = 1
    sky = 1 - ground - ego
    image[:, 2], image[:, 1] = 0.9 * sky[:, 0], 0.4 * (ground - road)[:, 0]
    return image + 0.4 * road, SceneMasks(sky, ground, road, ego)


FIRST, LAST = slice(40, 46), slice(66, 72)  # rows of the ground, far and near


@pytest.mark.parametrize(
    ("weather", "changed", "unchanged"),
    [
        (add_fog, (FIRST, slice(24, 40)), (LAST, slice(24, 40))),
        (add_snow, (LAST, slice(0, 20)), (slice(0, 38), slice(None))),
        (wet_road, (LAST, slice(24, 40)), (LAST, slice(0, 20))),
    ],
)
def test_weather_changes_what_it_lies_on(weather, changed, unchanged) -> None:
    image, scene = street()
    by = [
        (weather(image, scene, WeatherAugmentation(), seeded_generator(seed)) - image).abs()
        for seed in range(8)
    ]
    change = torch.stack(by).mean(0)
    assert not change[..., 72:, :].any()  # the ego car
    assert change[..., changed[0], changed[1]].mean() > 0.05
    assert (
        change[..., unchanged[0], unchanged[1]].mean()
        < change[..., changed[0], changed[1]].mean() / 3
    )


def test_lamps_shine_at_night_and_not_below_the_horizon() -> None:
    black, unlit = torch.zeros(1, 3, 80, 60), torch.ones(1, 1, 80, 60)
    for seed in range(6):
        night = darken_to_night(black, unlit, NightAugmentation(lamps=20), seeded_generator(seed))
        assert night[..., :48, :].amax() > 0.3
        assert night[..., 60:, :].amax() < 0.05


def test_other_surfaces_change_the_ground_and_leave_the_rest() -> None:
    image = torch.full((1, 3, 40, 60), 0.5)
    road, ground = torch.zeros(2, 1, 1, 40, 60)
    road[..., 30:, :], ground[..., 20:30, :] = 1, 1

    changed = retexture_road(image, road, ground, SurfaceAugmentation(), seeded_generator(6))

    assert torch.equal(changed[..., :20, :], image[..., :20, :])
    on_road, on_ground = (
        changed[0, :, rows].mean((1, 2)) for rows in (slice(30, 40), slice(20, 30))
    )
    assert (on_road - 0.5).abs().max() > 0.01
    assert (on_road - on_ground).abs().max() > 0.01
    assert 0 <= changed.min() <= changed.max() <= 1


def test_a_shadow_darkens_a_band_of_the_lower_part_and_nothing_else() -> None:
    image, settings = torch.full((1, 3, 80, 60), 0.8), ShadowAugmentation(min_brightness=0.25)

    images = [add_shadow(image, settings, seeded_generator(seed)) for seed in range(20)]

    for dark in images:
        assert torch.allclose(dark[..., :12, :], image[..., :12, :], atol=1e-3)
        assert 0.8 * 0.25 - 1e-3 <= dark.min() <= dark.max() <= 0.8 + 1e-6
    assert sum(float(dark.min()) < 0.8 * 0.72 for dark in images) >= 15  # a band may miss it


MASK = torch.zeros(2, 1, 40, 60)
MASK[..., 20:, :] = 1
ROAD = MASK * (torch.arange(60) < 30)
MASKED_SCENE = SceneMasks(1 - MASK, MASK, ROAD, 0 * MASK)

EFFECTS = {
    "light": lambda image, rng: jitter_light(image, LightAugmentation(), rng),
    "surface": lambda image, rng: retexture_road(image, MASK, 0 * MASK, SurfaceAugmentation(), rng),
    "shadow": lambda image, rng: add_shadow(image, ShadowAugmentation(), rng),
    "night": lambda image, rng: darken_to_night(image, 1 - MASK, NightAugmentation(), rng),
    "fog": lambda image, rng: add_fog(image, MASKED_SCENE, WeatherAugmentation(), rng),
    "snow": lambda image, rng: add_snow(image, MASKED_SCENE, WeatherAugmentation(), rng),
    "wet": lambda image, rng: wet_road(image, MASKED_SCENE, WeatherAugmentation(), rng),
    "rain": lambda image, rng: add_rain(image, MASKED_SCENE, WeatherAugmentation(), rng),
}


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_every_image_of_a_batch_gets_random_values_of_its_own(effect) -> None:
    image = scene(3, 40, 60).image.expand(2, -1, -1, -1)

    changed = effect(image, seeded_generator(4))

    assert changed.shape == image.shape
    assert not torch.allclose(changed[0], changed[1], atol=0.01)
    assert not torch.allclose(changed[0], image[0], atol=0.01)


def test_light_of_a_negative_rounding_error_is_a_number() -> None:
    image = torch.full((1, 3, 8, 8), -1e-9)
    assert jitter_light(image, LightAugmentation(), seeded_generator(1)).isfinite().all()


# --- ego cars ------------------------------------------------------------------------------


def car_of(height: int, width: int, rows: int) -> EgoCar:
    """Return a frame of noise whose lowest rows are the ego car."""
    ego = torch.zeros(1, 1, height, width)
    ego[..., height - rows :, :] = 1
    return EgoCar(torch.rand(1, 3, height, width, generator=seeded_generator(9)), ego)


def test_on_the_ego_car_there_is_no_road_no_layout_and_the_rest_stays() -> None:
    image = torch.rand(1, 3, 8, 10, generator=seeded_generator(1))
    targets = torch.rand(1, sum(TARGET_PLANES), 8, 10, generator=seeded_generator(2))
    car = car_of(8, 10, 3)

    covered, planes = paste_ego_car(image, targets, car)

    below = Targets(*planes[:, :, 5:].split(TARGET_PLANES, 1))
    assert not below.layout_weight.any()
    assert not below.road.any()
    for ones in (below.road_weight, below.ego, below.ego_weight):
        assert (ones == 1).all()
    torch.testing.assert_close(covered[:, :, 5:], car.image[:, :, 5:])
    assert torch.equal(covered[:, :, :5], image[:, :, :5])
    assert torch.equal(planes[:, :, :5], targets[:, :, :5])


def test_a_varied_car_covers_the_lower_edge_in_bounds_and_is_larger_or_brighter() -> None:
    settings = EgoCarAugmentation(growth=0.7, shrinkage=0.3, widening=0.25)
    cars = [
        jitter_ego_car(car_of(80, 60, 20), settings, seeded_generator(seed)) for seed in range(30)
    ]

    for car in cars:
        assert (car.ego[0, 0, -1] == 1).all()
        rows = car.ego[0, 0].sum(0)
        assert 20 * math.exp(-0.3) - 1 <= rows.min() <= rows.max() <= 20 * math.exp(0.7) + 1
        assert 0 <= car.image.min() <= car.image.max() <= 1
    heights = torch.stack([car.ego.sum(2).mean() for car in cars])
    light = torch.stack([car.image.mean() for car in cars])
    assert heights.min() < 18
    assert heights.max() > 30
    assert light.max() - light.min() > 0.2


def write_frame(path: Path, level: int) -> Path:
    """Write a prepared image of one grey: unknown above, free in the middle, ego car below."""
    ego = torch.tensor([128, 0, 255], dtype=torch.uint8)[:, None].expand(3, 4).contiguous()
    image = torch.full((3, 3, 4), level, dtype=torch.uint8)
    write_arrays(path, {"image": image, "ego": ego})
    return path


def test_each_recording_is_lent_as_often_however_many_frames_it_has(tmp_path: Path) -> None:
    frames = [write_frame(tmp_path / f"{level}.npz", level) for level in range(6)]
    recordings = {"one": frames[:1], "five": frames[1:]}

    cars = sample_ego_cars(recordings, 300, random.Random(4))

    levels = Counter((cars.image[:, 0, 0, 0] * 255).round().int().tolist())
    assert levels[0] == pytest.approx(150, abs=30)  # 3.5 deviations
    assert all(levels[level] == pytest.approx(30, abs=18) for level in range(1, 6))
    # Only the known ego car is lent.
    assert cars.ego[0, 0, :, 0].tolist() == [0, 0, 1]
