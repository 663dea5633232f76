"""Whole pictures in other frames and another light; ego cars laid over other streets."""

import math
from collections import Counter
from pathlib import Path

import pytest
import torch

from roadtorch.layout.classes import CLASSES
from roadtorch.train.augmentation import (
    EgoCar,
    EgoCarAugmentation,
    GeometryAugmentation,
    LightAugmentation,
    NightAugmentation,
    ShadowAugmentation,
    SurfaceAugmentation,
    at_night,
    draw_ego_car,
    draw_frames,
    laid_over,
    reframed,
    relit,
    resurfaced,
    shaded,
    varied,
)
from roadtorch.train.prepared import write_arrays
from roadtorch.train.teachers import PLANES, Targets
from tests.draws import seeded
from tests.streets import scene

STILL = GeometryAugmentation(scale=0, stretch=0, rotation=0, move=0)


def test_without_shift_a_frame_is_the_picture_or_its_mirror_image() -> None:
    maps = torch.rand(6, 2, 9, 12, generator=seeded(1))

    seen = reframed(maps, draw_frames(6, (9, 12), STILL, seeded(2)), "border")

    mirrored = [torch.allclose(a, b.flip(-1), atol=1e-5) for a, b in zip(seen, maps, strict=True)]
    same = [torch.allclose(a, b, atol=1e-5) for a, b in zip(seen, maps, strict=True)]
    assert all(a != b for a, b in zip(mirrored, same, strict=True))
    assert any(mirrored)
    assert any(same)


def test_a_turned_frame_keeps_its_shape() -> None:
    square = torch.zeros(1, 1, 60, 120)
    square[..., 20:40, 50:70] = 1

    frames = draw_frames(
        1, (60, 120), GeometryAugmentation(scale=0, stretch=0, rotation=45, move=0), seeded(4)
    )
    turned = reframed(square, frames, "zeros")

    assert float(turned.sum()) == pytest.approx(400, rel=0.02)


def test_what_is_outside_the_picture_does_not_count() -> None:
    frames = torch.tensor([[[1.0, 0, 1.0], [0, 1.0, 0]]])  # half a picture to the right

    seen = reframed(torch.ones(1, 1, 8, 8), frames, "zeros")

    assert seen[0, 0, 0].tolist() == [1, 1, 1, 1, 0, 0, 0, 0]


def test_light_changes_the_picture_and_stays_in_range() -> None:
    images = torch.stack([scene(seed, 60, 80).image for seed in range(4)])

    relit_images = relit(images, LightAugmentation(), seeded(3))

    assert relit_images.min() >= 0
    assert relit_images.max() <= 1
    change = (relit_images - images).abs().mean((1, 2, 3))
    assert (change > 0.01).all()
    none = LightAugmentation(gamma=0, gain=0, tint=0, saturation=0, noise=0)
    torch.testing.assert_close(relit(images, none, seeded(3)), images, atol=1e-4, rtol=0)


def test_of_a_lower_part_the_bottom_stays_and_the_top_goes() -> None:
    rows = torch.linspace(0, 1, 80)[None, None, :, None].expand(8, 1, 80, 60)

    frames = draw_frames(8, (80, 60), GeometryAugmentation(lower=1.0, cut=0.5), seeded(5))
    seen = reframed(rows, frames, "border")

    assert torch.allclose(seen[:, 0, -1], torch.ones(8, 60), atol=0.02)
    assert ((seen[:, 0, 0] >= -0.01) & (seen[:, 0, 0] <= 0.51)).all()
    assert seen[:, 0, 0].max() > 0.2
    assert frames[:, 0, 0].abs().max() <= 1  # nothing beside the picture is seen


def test_at_night_the_road_ahead_is_lit_and_what_has_no_light_is_dark() -> None:
    image = torch.full((1, 3, 80, 60), 0.8)
    unlit = torch.zeros(1, 1, 80, 60)
    unlit[..., 70:, :] = 1
    nights = NightAugmentation(darkest=0.05, lamps=0)

    found = [at_night(image, unlit, nights, seeded(seed)) for seed in range(12)]

    for one in found:
        ahead, above = one[..., 44:66, 24:36].amax(), one[..., :20, :].amax()
        assert ahead > 2 * above
        assert one[..., 70:, :].amax() <= 0.8 * 0.3 * 1.3 + 1e-6
    assert len({float(one.mean()) for one in found}) == len(found)


def test_lamps_shine_at_night_and_not_below_the_horizon() -> None:
    black = torch.zeros(1, 3, 80, 60)
    unlit = torch.ones(1, 1, 80, 60)

    found = [at_night(black, unlit, NightAugmentation(lamps=20), seeded(seed)) for seed in range(6)]

    for one in found:
        assert one[..., :48, :].amax() > 0.3
        assert one[..., 60:, :].amax() < 0.05


def test_other_surfaces_change_the_ground_and_leave_the_rest() -> None:
    image = torch.full((1, 3, 40, 60), 0.5)
    road, ground = torch.zeros(1, 1, 40, 60), torch.zeros(1, 1, 40, 60)
    road[..., 30:, :], ground[..., 20:30, :] = 1, 1

    changed = resurfaced(image, road, ground, SurfaceAugmentation(), seeded(6))

    assert torch.equal(changed[..., :20, :], image[..., :20, :])
    on_road, beside = (changed[0, :, rows].mean((1, 2)) for rows in (slice(30, 40), slice(20, 30)))
    assert (on_road - 0.5).abs().max() > 0.01
    assert (on_road - beside).abs().max() > 0.01
    assert changed.min() >= 0
    assert changed.max() <= 1


def test_a_shadow_darkens_a_band_of_the_lower_part_and_nothing_else() -> None:
    image = torch.full((1, 3, 80, 60), 0.8)

    found = [shaded(image, ShadowAugmentation(darkest=0.25), seeded(seed)) for seed in range(20)]

    for one in found:
        assert torch.allclose(one[..., :12, :], image[..., :12, :], atol=1e-3)
        assert 0.8 * 0.25 - 1e-3 <= one.min() <= one.max() <= 0.8 + 1e-6
    assert sum(float(one.min()) < 0.8 * 0.72 for one in found) >= 15  # a band may miss the picture


STILL_CAR = EgoCarAugmentation(tallest=0, flattest=0, widest=0, light=0)


def car_of(height: int, width: int, rows: int) -> EgoCar:
    """A frame of noise whose lowest rows are the ego car."""
    ego = torch.zeros(1, 1, height, width)
    ego[..., height - rows :, :] = 1
    return EgoCar(torch.rand(1, 3, height, width, generator=seeded(9)), ego)


# --- laid over -----------------------------------------------------------------------------


def test_on_the_ego_car_there_is_no_road_no_layout_and_what_is_not_covered_stays() -> None:
    image = torch.rand(1, 3, 8, 10, generator=seeded(1))
    targets = torch.rand(1, sum(PLANES), 8, 10, generator=seeded(2))
    car = car_of(8, 10, 3)

    seen, said = laid_over(image, targets, car)

    below = Targets(*said[:, :, 5:].split(PLANES, 1))
    assert not below.layout_weight.any()
    assert not below.road.any()
    assert (below.road_weight == 1).all()
    assert (below.ego == 1).all()
    assert (below.ego_weight == 1).all()
    torch.testing.assert_close(seen[:, :, 5:], car.image[:, :, 5:])
    assert torch.equal(seen[:, :, :5], image[:, :, :5])
    assert torch.equal(said[:, :, :5], targets[:, :, :5])


def test_a_soft_edge_is_mixed_in_the_picture_and_one_or_the_other_in_the_targets() -> None:
    car = EgoCar(torch.ones(1, 3, 1, 2), torch.tensor([0.4, 0.6]).reshape(1, 1, 1, 2))
    targets = torch.full((1, sum(PLANES), 1, 2), 0.5)

    seen, said = laid_over(torch.zeros(1, 3, 1, 2), targets, car)

    torch.testing.assert_close(seen[0, 0, 0], torch.tensor([0.4, 0.6]))
    assert said[0, CLASSES + 3, 0].tolist() == [0.5, 1.0]  # the ego car's plane


# --- varied --------------------------------------------------------------------------------


def test_however_it_is_varied_it_covers_the_lower_edge_and_has_a_height_within_bounds() -> None:
    settings = EgoCarAugmentation(tallest=0.7, flattest=0.3, widest=0.25)

    for seed in range(30):
        car = varied(car_of(80, 60, 20), settings, seeded(seed))

        assert (car.ego[0, 0, -1] == 1).all()
        rows = car.ego[0, 0].sum(0)
        assert rows.min() >= 20 * math.exp(-0.3) - 1
        assert rows.max() <= 20 * math.exp(0.7) + 1
        assert 0 <= car.image.min() <= car.image.max() <= 1


def test_it_becomes_larger_and_smaller_brighter_and_darker() -> None:
    cars = [varied(car_of(80, 60, 20), EgoCarAugmentation(), seeded(seed)) for seed in range(30)]

    heights = torch.stack([car.ego.sum(2).mean() for car in cars])
    light = torch.stack([car.image.mean() for car in cars])
    assert heights.min() < 18
    assert heights.max() > 30
    assert light.max() - light.min() > 0.2


def test_without_variation_a_car_is_seen_as_it_is_at_either_side() -> None:
    car = car_of(16, 20, 4)
    car.ego[..., 10:] = 0

    found = [varied(car, STILL_CAR, seeded(seed)) for seed in range(20)]

    left, right = (
        [
            torch.allclose(one.ego, ego, atol=1e-5) and torch.allclose(one.image, image, atol=1e-3)
            for one in found
        ]
        for ego, image in ((car.ego, car.image), (car.ego.flip(-1), car.image.flip(-1)))
    )
    assert any(left)
    assert any(right)
    assert all(one != other for one, other in zip(left, right, strict=True))


# --- lent ----------------------------------------------------------------------------------


def write_frame(path: Path, level: int) -> Path:
    """A prepared picture of one grey: unknown above, free in the middle, ego car below."""
    ego = torch.tensor([128, 0, 255], dtype=torch.uint8)[:, None].expand(3, 4).contiguous()
    image = torch.full((3, 3, 4), level, dtype=torch.uint8)
    write_arrays(path, {"image": image, "ego": ego})
    return path


def test_each_recording_is_lent_as_often_however_many_frames_it_has(tmp_path: Path) -> None:
    frames = [write_frame(tmp_path / f"{level}.npz", level) for level in range(6)]
    recordings = {"one": frames[:1], "five": frames[1:]}
    at = seeded(4)

    drawn = Counter(
        round(float(draw_ego_car(recordings, STILL_CAR, at).image[0, 0, 0, 0]) * 255)
        for _ in range(300)
    )

    assert drawn[0] == pytest.approx(150, abs=30)  # 3.5 deviations
    assert all(drawn[level] == pytest.approx(30, abs=18) for level in range(1, 6))


def test_only_what_is_known_to_be_ego_car_is_lent(tmp_path: Path) -> None:
    car = draw_ego_car({"a": [write_frame(tmp_path / "a.npz", 51)]}, STILL_CAR, seeded(0))

    assert car.ego[0, 0, :, 0].tolist() == [0, 0, 1]
    torch.testing.assert_close(car.image, torch.full((1, 3, 3, 4), 0.2))
