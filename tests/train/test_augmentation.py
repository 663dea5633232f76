"""Augmentation of whole images: geometry, light, weather; ego cars pasted over streets."""

import math
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from roadtorch.run.memo import write_arrays
from roadtorch.train import effects
from roadtorch.train.augmentation import (
    EgoCar,
    augment_batch,
    jitter_ego_car,
    paste_ego_car,
    sample_affine,
    sample_ego_cars,
    warp_affine,
)
from roadtorch.train.config import Augmentation, GeometryAugmentation
from roadtorch.train.targets import TARGET_PLANES, Targets, split_targets
from tests.draws import seeded_generator
from tests.streets import scene

STILL = GeometryAugmentation(scale=0, stretch=0, rotation=0, translation=0)

# --- geometry ------------------------------------------------------------------------------


@pytest.mark.parametrize(("mirror", "signs"), [(0.0, {1}), (1.0, {-1}), (0.5, {-1, 1})])
def test_without_shift_a_frame_is_the_image_or_its_mirror_image(
    mirror: float, signs: set[int]
) -> None:
    maps = torch.rand(2, 9, 12, generator=seeded_generator(1))
    geometry = STILL.model_copy(update={"mirror": mirror})
    frames = sample_affine(9, (9, 12), geometry, seeded_generator(2))
    images = warp_affine(maps.expand(9, -1, -1, -1), frames, "border")
    sides = {1: maps, -1: maps.flip(-1)}
    equal = [{s for s in sides if image.allclose(sides[s], atol=1e-5)} for image in images]
    assert set.union(*equal) == signs
    assert all(equal)


def test_of_a_lower_part_the_bottom_stays_and_the_top_goes() -> None:
    rows = torch.linspace(0, 1, 80)[None, None, :, None].expand(8, 1, 80, 60)

    geometry = GeometryAugmentation(crop_probability=1.0)
    frames = sample_affine(8, (80, 60), geometry, seeded_generator(5))
    images = warp_affine(rows, frames, "border")

    assert torch.allclose(images[:, 0, -1], torch.ones(8, 60), atol=0.02)
    assert ((images[:, 0, 0] >= -0.01) & (images[:, 0, 0] <= 0.51)).all()
    assert images[:, 0, 0].max() > 0.2
    assert frames[:, 0, 0].abs().max() <= 1  # nothing beside the image is seen


# --- effects -------------------------------------------------------------------------------


def street() -> tuple[Tensor, Targets]:
    """Return blue sky above row 40, a grey road between green, and an ego car from row 72 on."""
    image, ground, road, ego = torch.zeros(1, 3, 80, 64), *(torch.zeros(3, 1, 1, 80, 64))
    ground[..., 40:72, :] = road[..., 40:72, 24:40] = ego[..., 72:, :] = 1
    sky, ones = 1 - ground - ego, torch.ones_like(ground)
    image[:, 2], image[:, 1] = 0.9 * sky[:, 0], 0.4 * (ground - road)[:, 0]
    layout = torch.cat([sky, 0 * sky, ground], 1)
    return image + 0.4 * road, Targets(layout, ones, road, ones, ego, ones)


Effect = Callable[[Tensor, Targets, torch.Generator], Tensor]
Area = tuple[slice, slice]

ROAD, BESIDE, SKY = slice(24, 40), slice(0, 20), (slice(0, 38), slice(None))
FAR, NEAR = slice(40, 46), slice(66, 72)


@pytest.mark.parametrize(
    ("effect", "changed", "unchanged"),
    [
        (effects.add_fog, (FAR, ROAD), (NEAR, ROAD)),
        (effects.add_snow, (NEAR, BESIDE), SKY),
        (effects.wet_road, (NEAR, ROAD), (NEAR, BESIDE)),
        (effects.retexture_ground, (NEAR, BESIDE), SKY),
        (effects.retexture_ground, (NEAR, ROAD), SKY),
    ],
)
def test_an_effect_changes_what_it_lies_on(effect: Effect, changed: Area, unchanged: Area) -> None:
    image, scene = street()
    seeds = map(seeded_generator, range(8))
    change = torch.stack([(effect(image, scene, rng) - image).abs() for rng in seeds]).mean(0)
    assert not change[..., 72:, :].any()  # the ego car
    assert change[..., *changed].mean() > 0.03
    assert change[..., *unchanged].mean() < change[..., *changed].mean() / 3


def test_road_and_other_ground_get_surfaces_of_their_own() -> None:
    image, scene = torch.full((1, 3, 80, 64), 0.5), street()[1]
    changed = effects.retexture_ground(image, scene, seeded_generator(6))
    road, ground = (changed[0, :, 40:72, part].mean((1, 2)) for part in (ROAD, BESIDE))
    assert (road - ground).abs().max() > 0.01


def test_a_shadow_darkens_a_band_of_the_lower_part_and_nothing_else() -> None:
    image, scene = torch.full((1, 3, 80, 64), 0.8), street()[1]

    images = [effects.add_shadow(image, scene, seeded_generator(seed)) for seed in range(20)]

    for dark in images:
        assert torch.allclose(dark[..., :12, :], image[..., :12, :], atol=1e-3)
        assert 0.8 * 0.25 - 1e-3 <= dark.min() <= dark.max() <= 0.8 + 1e-6
    assert sum(float(dark.min()) < 0.8 * 0.72 for dark in images) >= 15  # a band may miss it


def test_at_night_the_road_ahead_is_lit_and_the_ego_car_is_dark_and_lamps_are_above() -> None:
    day, black, scene = torch.full((1, 3, 80, 64), 0.8), torch.zeros(1, 3, 80, 64), street()[1]
    lamps = []
    for seed in range(12):
        night = effects.darken_to_night(day, scene, seeded_generator(seed))
        assert night[..., 48:66, 26:38].mean() > 2 * night[..., :20, :].quantile(0.1)
        assert night[..., 72:, :].amax() <= 0.8 * 0.3 * 1.3 + 0.05
        lamps.append(effects.darken_to_night(black, scene, seeded_generator(seed)))
        assert lamps[-1][..., 60:, :].amax() < 0.05
    assert sum(float(night[..., :48, :].amax()) > 0.3 for night in lamps) >= 6


EFFECTS: dict[str, Effect] = {
    "light": lambda image, _, rng: effects.jitter_light(image, rng),
    "surface": effects.retexture_ground,
    "shadow": effects.add_shadow,
    "night": effects.darken_to_night,
    "fog": effects.add_fog,
    "snow": effects.add_snow,
    "wet": effects.wet_road,
    "rain": effects.add_rain,
}


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_every_image_of_a_batch_gets_random_values_of_its_own(effect: Effect) -> None:
    image = scene(3, 80, 64).image.expand(2, -1, -1, -1)
    targets = Targets(*(plane.expand(2, -1, -1, -1) for plane in street()[1]))

    changed = effect(image, targets, seeded_generator(4))

    assert changed.shape == image.shape
    assert 0 <= changed.min() <= changed.max() <= 1
    assert not torch.allclose(changed[0], changed[1], atol=0.01)
    assert not torch.allclose(changed[0], image[0], atol=0.01)


def test_light_of_a_negative_rounding_error_is_a_number() -> None:
    image = torch.full((1, 3, 8, 8), -1e-9)
    assert effects.jitter_light(image, seeded_generator(1)).isfinite().all()


# --- ego cars ------------------------------------------------------------------------------


def car_of(height: int, width: int, rows: int) -> EgoCar:
    """Return a frame of noise whose lowest rows are the ego car."""
    ego = torch.zeros(1, 1, height, width)
    ego[..., height - rows :, :] = 1
    return EgoCar(torch.rand(1, 3, height, width, generator=seeded_generator(9)), ego)


def test_on_the_ego_car_there_is_no_road_no_layout_and_the_rest_stays() -> None:
    image = torch.rand(1, 3, 8, 10, generator=seeded_generator(1))
    targets = torch.rand(1, sum(TARGET_PLANES), 8, 10, generator=seeded_generator(2))
    planes, car = targets.clone(), car_of(8, 10, 3)

    covered = paste_ego_car(image, split_targets(planes), car)

    below = split_targets(planes[:, :, 5:])
    assert not any(part.any() for part in (below.layout_weight, below.road))
    assert all((part == 1).all() for part in (below.road_weight, below.ego, below.ego_weight))
    torch.testing.assert_close(covered[:, :, 5:], car.image[:, :, 5:])
    assert torch.equal(covered[:, :, :5], image[:, :, :5])
    assert torch.equal(planes[:, :, :5], targets[:, :, :5])


def test_a_varied_car_covers_the_lower_edge_in_bounds_and_is_larger_or_brighter() -> None:
    cars = [jitter_ego_car(car_of(80, 60, 20), 0.7, seeded_generator(seed)) for seed in range(30)]

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


def test_each_recording_is_lent_as_often_however_many_frames_it_has(tmp_path: Path) -> None:
    """Use frames of one grey: unknown above, free in the middle, ego car below."""
    ego = torch.tensor([128, 0, 255], dtype=torch.uint8)[:, None].expand(3, 4).contiguous()
    frames = [tmp_path / f"{level}.npz" for level in range(6)]
    for level, file in enumerate(frames):
        image = torch.full((3, 3, 4), level, dtype=torch.uint8)
        write_arrays(file, {"image": image, "ego": ego})

    cars = sample_ego_cars({"one": frames[:1], "five": frames[1:]}, 300, random.Random(4))

    levels = Counter((cars.image[:, 0, 0, 0] * 255).round().int().tolist())
    assert levels[0] == pytest.approx(150, abs=30)  # 3.5 deviations
    assert all(levels[level] == pytest.approx(30, abs=18) for level in range(1, 6))
    # Only the known ego car is lent.
    assert cars.ego[0, 0, :, 0].tolist() == [0, 0, 1]


def test_every_image_of_a_batch_can_get_an_ego_car(tmp_path: Path) -> None:
    image, targets = street()
    planes = torch.cat(targets, 1)
    planes[:, 6:, 72:] = 0  # no ego car of its own is known
    ego = (torch.arange(80) >= 60)[:, None].expand(80, 64).to(torch.uint8) * 255
    pixels = torch.full((3, 80, 64), 200, dtype=torch.uint8)
    write_arrays(tmp_path / "a.npz", {"image": pixels, "ego": ego})
    settings = Augmentation(geometry=STILL, ego_car=1.0)

    def augmented(cars: dict[str, list[Path]]) -> Targets:
        images, targets = (part.expand(4, -1, -1, -1).clone() for part in (image, planes))
        rng = seeded_generator(0)
        _, targets = augment_batch(images, targets, settings, lambda maps: maps, cars, rng)
        return split_targets(targets)

    covered, bare = augmented({"drive": [tmp_path / "a.npz"]}), augmented({})

    assert (covered.ego[:, :, -1] == 1).all()
    assert (covered.ego_weight[:, :, -1] == 1).all()
    assert not covered.road[:, :, -1].any()
    assert covered.road[:, :, 40:44].flatten(1).any(1).all()  # above it, the road is what it was
    assert not bare.ego.any()
