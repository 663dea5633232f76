"""A textured plane driven over: the camera's way is found again, and drawn where it went."""

import cv2
import numpy as np
import pytest
import torch

from roadtorch.adapt.evidence import footage_evidence, time_evidence
from roadtorch.adapt.ground_motion import (
    FOCAL,
    Mount,
    drive_of,
    plane_homography,
    rays,
    rotation,
    seen_from,
    smoothest,
    way,
)

HEIGHT, WIDTH = 240, 320
PITCH, HEADING, FORWARD, YAW = 0.08, 0.03, 0.4, 0.004


def driven(frames: int, forward: float = FORWARD) -> list[np.ndarray]:
    """Grey frames uint8 of grainy ground, a wall beside it and hills, from a car in a bend."""
    mount = torch.tensor([PITCH, HEADING]).double()
    grain = np.random.default_rng(0).uniform(30, 220, (1500, 1500)).astype(np.float32)
    grain = cv2.GaussianBlur(grain, (0, 0), 1.2) * 3 - 250
    turn, move = torch.eye(3).double(), torch.zeros(3).double()
    one = rotation(torch.tensor([YAW, 0, 0]).double())
    below = np.array([0, np.cos(PITCH), np.sin(PITCH)])
    pictures = []
    for _ in range(frames):
        where = rays(HEIGHT, WIDTH).double() @ turn  # into the first camera's frame
        at = -turn.T @ move
        slope = (where @ torch.from_numpy(below)).numpy()
        left = -where[..., 0].numpy()
        ground = (1 - float(at @ torch.from_numpy(below))) / np.where(slope > 1e-3, slope, np.nan)
        wall = (4 + float(at[0])) / np.where(left > 1e-3, left, np.nan)
        deep = np.fmin(ground, wall)
        places = at.numpy() + where.numpy() * deep[..., None]
        is_wall = np.nan_to_num(wall, nan=1e9) < np.nan_to_num(ground, nan=1e9)
        u = np.where(is_wall, places[..., 1] * 12 + 700, places[..., 0] * 12 + 300)
        v = places[..., 2] * 12
        seen = cv2.remap(
            grain,
            (u % 1500).astype(np.float32),
            (v % 1500).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        haze = (np.nan_to_num(deep, nan=99) / 15).clip(0, 1)
        far = (where[..., :2] / where[..., 2:] * 250 + 700).numpy().astype(np.float32)
        hills = cv2.remap(grain, far[..., 0], far[..., 1], cv2.INTER_LINEAR)
        hills = np.where(far[..., 1] > 660, hills, 200)  # with sky above
        shown = np.where(np.isnan(deep), hills, np.nan_to_num(seen) * (1 - haze) + 128 * haze)
        pictures.append(shown.clip(0, 255).astype(np.uint8))
        turn, move = one @ turn, one @ move - forward * (one @ way(mount))
    return pictures


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return driven(14)


def likelihood() -> torch.Tensor:
    """Road in the lower half."""
    rows = torch.arange(120)[:, None].expand(120, 160)
    return (rows > 60) * 0.8 + 0.1


def images(pictures: list[np.ndarray]) -> list[torch.Tensor]:
    return [torch.from_numpy(one).expand(3, -1, -1).to(torch.float32) / 255 for one in pictures]


def test_the_way_over_the_ground_is_found(pictures: list[np.ndarray]) -> None:
    greys = [torch.from_numpy(one) for one in pictures]
    road = torch.nn.functional.interpolate(likelihood()[None, None], (HEIGHT, WIDTH))[0, 0]
    drive = drive_of(greys, [road] * len(greys), Mount(0.0, 0.0))
    assert drive.words == []
    assert drive.mount.pitch == pytest.approx(PITCH, abs=0.015)
    assert drive.mount.heading == pytest.approx(HEADING, abs=0.015)
    steps = np.diff(drive.keys)
    assert drive.move.norm(dim=-1).numpy() == pytest.approx(FORWARD * steps, rel=0.15)
    assert drive.turn[:, 2, 0].numpy() == pytest.approx(YAW * steps, abs=0.003)


def test_the_path_is_where_the_vehicle_went(pictures: list[np.ndarray]) -> None:
    found = footage_evidence(images(pictures), [likelihood()] * len(pictures))
    weight = found.teachers[0]["path"].weight
    bottom = weight[-4].nonzero()[:, 0].to(torch.float32)
    # At the lower edge it is half a camera's height to each side of the heading, in pixels.
    depth = np.sin(PITCH) + np.cos(PITCH) * (115.5 - 59.5) / (FOCAL * 160)
    assert bottom.mean() == pytest.approx(79.5 + HEADING * FOCAL * 160, abs=4)
    assert len(bottom) == pytest.approx(depth * FOCAL * 160, rel=0.15)
    horizon = 59.5 - np.tan(PITCH) * FOCAL * 160
    assert not weight[: int(horizon) + 1].any()
    assert found.teachers[-1]["path"].weight.sum() == 0  # nobody knows what comes after the end
    sums = [float(one["path"].weight.sum()) for one in found.teachers]
    assert sums[0] > min(one for one in sums if one) > 0


def test_frames_that_stand_still_say_nothing_of_a_path(pictures: list[np.ndarray]) -> None:
    found = footage_evidence(images(pictures[:1] * 12), [likelihood()] * 12)
    assert any("still" in word for word in found.words)
    assert all(one["path"].weight.sum() == 0 for one in found.teachers)


def test_pictures_without_order_say_nothing_of_a_path() -> None:
    noise = torch.rand(12, 3, 120, 160, generator=torch.Generator().manual_seed(0))
    found = footage_evidence(list(noise), [likelihood()] * 12)
    assert found.words
    assert all(one["path"].weight.sum() == 0 for one in found.teachers)


@pytest.mark.parametrize("count", [0, 1, 9])
def test_few_frames_say_nothing(count: int) -> None:
    found = footage_evidence([torch.rand(3, 60, 80)] * count, [likelihood()] * count)
    assert len(found.teachers) == count
    assert len(found.words) == 1
    assert all(said.weight.sum() == 0 for one in found.teachers for said in one.values())


def test_frames_of_several_sizes_are_told(pictures: list[np.ndarray]) -> None:
    frames = images(pictures)
    frames[3] = frames[3][:, :100]
    found = footage_evidence(frames, [likelihood()] * len(frames))
    assert "sizes" in found.words[0]


def test_time_overrules_one_frame_and_doubts_what_flickers(pictures: list[np.ndarray]) -> None:
    greys = [torch.from_numpy(pictures[0])] * 9
    steady = [torch.full((120, 160), 0.9) for _ in range(9)]
    steady[4] = torch.full((120, 160), 0.2)
    ego = torch.zeros(120, 160, dtype=torch.bool)
    ego[100:] = True
    said = time_evidence(greys, steady, ego)
    assert said[4].road[50, 80] > 0.8
    assert said[4].weight[50, 80] < said[0].weight[50, 80]
    assert said[4].weight[ego].sum() == 0


def test_time_does_not_reach_beyond_a_cut(pictures: list[np.ndarray]) -> None:
    noise = torch.from_numpy(np.random.default_rng(1).integers(0, 255, (240, 320), np.uint8))
    greys, likely = [torch.from_numpy(pictures[0]), noise], torch.full((60, 80), 0.9)
    said = time_evidence(greys, [likely, 1 - likely], torch.zeros(60, 80) > 0)
    assert said[0].road.mean() == pytest.approx(0.9, abs=0.02)
    assert said[0].weight.mean() < 0.1


def test_the_smoothest_way_ignores_one_pair_that_errs() -> None:
    costs = torch.full((7, 32), 30.0)
    costs[:, 10] = 0.0
    costs[3, 10], costs[3, 25] = 30.0, 0.0
    assert smoothest(costs).tolist() == [10] * 7


def test_what_a_turn_shows_is_seen_from_there() -> None:
    picture = torch.rand(60, 80)
    seen = seen_from(picture, torch.eye(3))[:-1, :-1]  # the last ones are between pixels
    assert torch.allclose(seen, picture[:-1, :-1], atol=1e-4)
    far = plane_homography(torch.eye(3), torch.tensor([0.0, 0.0, -1.0]), Mount(0.1, 0.0), 0.0)
    assert torch.equal(far, torch.eye(3))
