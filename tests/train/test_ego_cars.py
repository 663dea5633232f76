"""Ego cars that are cut out, varied and laid over other streets."""

import math
from collections import Counter
from pathlib import Path

import pytest
import torch

from roadtorch.layout.classes import CLASSES
from roadtorch.train.augmentation import EgoCar, laid_over, lent, varied
from roadtorch.train.config import EgoCars
from roadtorch.train.prepared import write_arrays
from roadtorch.train.teachers import PLANES, Targets

STILL = EgoCars(tallest=0, flattest=0, widest=0, light=0)


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def car_of(height: int, width: int, rows: int) -> EgoCar:
    """A frame of noise whose lowest rows are the ego car."""
    ego = torch.zeros(1, 1, height, width)
    ego[..., height - rows :, :] = 1
    return EgoCar(torch.rand(1, 3, height, width, generator=seeded(9)), ego)


# --- laid over -----------------------------------------------------------------------------


def test_on_the_ego_car_there_is_no_road_no_layout_and_the_ego_car_is_known() -> None:
    image, targets = torch.zeros(1, 3, 8, 10), torch.rand(1, sum(PLANES), 8, 10)
    car = car_of(8, 10, 3)

    seen, said = laid_over(image, targets, car)

    below = Targets(*said[:, :, 5:].split(PLANES, 1))
    assert not below.layout_weight.any()
    assert not below.road.any()
    assert (below.road_weight == 1).all()
    assert (below.ego == 1).all()
    assert (below.ego_weight == 1).all()
    torch.testing.assert_close(seen[:, :, 5:], car.image[:, :, 5:])


def test_what_is_not_covered_stays() -> None:
    image = torch.rand(1, 3, 8, 10, generator=seeded(1))
    targets = torch.rand(1, sum(PLANES), 8, 10, generator=seeded(2))

    seen, said = laid_over(image, targets, car_of(8, 10, 3))

    assert torch.equal(seen[:, :, :5], image[:, :, :5])
    assert torch.equal(said[:, :, :5], targets[:, :, :5])


def test_a_soft_edge_is_mixed_in_the_picture_and_one_or_the_other_in_the_targets() -> None:
    car = EgoCar(torch.ones(1, 3, 1, 2), torch.tensor([0.4, 0.6]).reshape(1, 1, 1, 2))
    targets = torch.full((1, sum(PLANES), 1, 2), 0.5)

    seen, said = laid_over(torch.zeros(1, 3, 1, 2), targets, car)

    torch.testing.assert_close(seen[0, 0, 0], torch.tensor([0.4, 0.6]))
    assert said[0, CLASSES + 3, 0].tolist() == [0.5, 1.0]  # the ego car's plane


# --- varied --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(30))
def test_however_it_is_varied_it_covers_the_lower_edge_and_has_a_height_within_bounds(
    seed: int,
) -> None:
    settings = EgoCars(tallest=0.7, flattest=0.3, widest=0.25)

    car = varied(car_of(80, 60, 20), settings, seeded(seed))

    assert (car.ego[0, 0, -1] == 1).all()
    rows = car.ego[0, 0].sum(0)
    assert rows.min() >= 20 * math.exp(-0.3) - 1
    assert rows.max() <= 20 * math.exp(0.7) + 1
    assert 0 <= car.image.min() <= car.image.max() <= 1


def test_it_becomes_larger_and_smaller_brighter_and_darker() -> None:
    cars = [varied(car_of(80, 60, 20), EgoCars(), seeded(seed)) for seed in range(30)]

    heights = torch.stack([car.ego.sum(2).mean() for car in cars])
    light = torch.stack([car.image.mean() for car in cars])
    assert heights.min() < 18
    assert heights.max() > 30
    assert light.max() - light.min() > 0.2


def test_a_car_at_one_side_is_seen_at_either() -> None:
    car = car_of(16, 20, 4)
    car.ego[..., 10:] = 0

    found = [varied(car, STILL, seeded(seed)).ego for seed in range(20)]

    left = [torch.allclose(each, car.ego, atol=1e-5) for each in found]
    right = [torch.allclose(each, car.ego.flip(-1), atol=1e-5) for each in found]
    assert any(left)
    assert any(right)
    assert all(one != other for one, other in zip(left, right, strict=True))


def test_without_variation_frame_and_light_stay() -> None:
    car = car_of(16, 20, 4)

    same = varied(car, STILL, seeded(3))

    flipped = torch.allclose(same.image, car.image.flip(-1), atol=1e-3)
    assert flipped or torch.allclose(same.image, car.image, atol=1e-3)


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

    drawn = Counter(round(float(lent(recordings, at).image[0, 0, 0, 0]) * 255) for _ in range(300))

    assert drawn[0] == pytest.approx(150, abs=30)  # 3.5 deviations
    assert all(drawn[level] == pytest.approx(30, abs=18) for level in range(1, 6))


def test_only_what_is_known_to_be_ego_car_is_lent(tmp_path: Path) -> None:
    car = lent({"a": [write_frame(tmp_path / "a.npz", 51)]}, seeded(0))

    assert car.ego[0, 0, :, 0].tolist() == [0, 0, 1]
    torch.testing.assert_close(car.image, torch.full((1, 3, 3, 4), 0.2))
