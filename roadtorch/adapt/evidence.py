"""What footage knows of its road, frame by frame: teachers that need no labels.

Each says of a pixel that it is road or not, and how sure it is; where it knows nothing, its
weight is 0.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.adapt.ground_motion import FOCAL, FRAMES, WIDTH, Drive, Mount, down, drive_of, way
from roadtorch.camera.footage import still_ego
from roadtorch.camera.gradients import gradients, small_grey, small_size, vanishing_point
from roadtorch.imaging.motion import flow_picture
from roadtorch.road.fusion import log_odds
from roadtorch.road.steady import Observation, Past, SteadySettings, recalled

HALF = 0.5
"""Half of the width of the path in heights of the camera: 1.4 m at 1.4 m, the tyres of a car."""

REACH = 15.0
"""Heights of the camera up to which the path is drawn: 21 m for a car's, closer than which
others seldom drive ahead."""

OVERLAP = 60
"""Frames of the footage to give again with the next ones: two seconds and more see the path."""

LOOKS = 30
"""Frames that are looked at for what stays the same in all of them."""

STRAY = 0.03
"""Radians by which the path may have left its course at that distance, as a rule."""


class Evidence(NamedTuple):
    """What one teacher says of a frame: road (h,w) and how sure it is, weight (h,w), in [0,1]."""

    road: Tensor
    weight: Tensor


def nothing(size: tuple[int, int]) -> Evidence:
    """Nothing said of a frame (h,w)."""
    return Evidence(torch.full(size, 0.5), torch.zeros(size))


# --- where the vehicle went ------------------------------------------------------------------


def path_evidence(drive: Drive, size: tuple[int, int], ego: Tensor) -> dict[int, Evidence]:
    """Road where the vehicle drives next, for each key frame of a drive, at maps' size (h,w).

    ego: the vehicle in the picture, bool (h,w): nothing is said of it.
    """
    found = {}
    for at, key in enumerate(drive.keys):
        weight = torch.from_numpy(_path_weight(drive, at, size)).masked_fill(ego, 0.0)
        found[key] = Evidence((weight > 0).to(torch.float32), weight)
    return found


def _path_weight(drive: Drive, at: int, size: tuple[int, int]) -> np.ndarray:
    """How sure the path after key ``at`` is road, float32 (h,w): near strips over far ones."""
    rails, far = wheels(drive, at)
    height, width = size
    focal = FOCAL * width
    weight = np.zeros(size, np.float32)
    for one, other, distance in reversed(list(zip(rails, rails[1:], far, strict=False))):
        corners = np.stack([one[0], one[1], other[1], other[0]])
        if corners[:, 2].min() < 0.2:
            continue
        pixels = corners[:, :2] / corners[:, 2:] * focal + ((width - 1) / 2, (height - 1) / 2)
        doubt = STRAY * distance / HALF
        sure = math.exp(-(doubt**2))
        inside = pixels.clip(-8 * width, 8 * width).round().astype(np.int32)
        cv2.fillConvexPoly(weight, inside, sure)
    return weight


def wheels(drive: Drive, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the vehicle's left and right wheels come, (n,2,3), in the frame of key ``at``.

    Also the way to there (n,), in heights. They end where the drive cannot be told.
    """
    below = down(torch.tensor(drive.mount)).double()
    along = way(torch.tensor(drive.mount)).double()
    right = torch.linalg.cross(below, along) * HALF
    turn, move = torch.eye(3).double(), torch.zeros(3).double()
    places, far = [torch.stack([below - right, below + right])], [0.0]
    for one, step in zip(drive.turn[at:].double(), drive.move[at:].double(), strict=True):
        if step.isnan().any() or far[-1] > REACH:
            break
        turn, move = one @ turn, one @ move + step
        middle = turn.T @ (below - move)
        side = turn.T @ right
        places.append(torch.stack([middle - side, middle + side]))
        far.append(far[-1] + float(step.norm()))
    return _finer(torch.stack(places).numpy(), np.array(far))


def _finer(places: np.ndarray, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (n,2,3) at ways (n,) with more between them: the first is below the camera."""
    if len(far) < 2:
        return places, far
    ways = np.arange(0.0, far[-1], 0.25)
    flat = places.reshape(len(far), 6)
    between = np.stack([np.interp(ways, far, part) for part in flat.T], -1)
    return between.reshape(-1, 2, 3), ways


# --- time ---------------------------------------------------------------------------------------


def time_evidence(
    greys: Sequence[Tensor], likelihoods: Sequence[Tensor], ego: Tensor
) -> list[Evidence]:
    """What the frames before and after say of the same places, for each frame, at maps' size.

    Log odds carried along the motion of the picture (``road.steady``), forwards and backwards;
    the mean of all is said, and surely where past, present and future agree. greys: uint8
    (h,w). likelihoods: (H,W) in [0,1]. ego: bool (H,W), of which nothing is said.
    """
    none = torch.zeros_like(ego)
    seen = [
        Observation(grey, log_odds(likelihood), none)
        for grey, likelihood in zip(greys, likelihoods, strict=True)
    ]
    found = []
    for past, future, now in zip(_passed(seen), _passed(seen[::-1])[::-1], seen, strict=True):
        before, after = (_at_size(known.frames, now.odds) for known in (past, future))
        frames = (before + after - 1).clamp_min(1.0)
        odds = (before * past.odds + after * future.odds - now.odds) / frames
        three = torch.stack([past.odds, now.odds, future.odds]).sigmoid()
        agree = 1 - (three.amax(0) - three.amin(0))
        weight = (agree * (1 - 1 / frames)).clamp(0, 1).masked_fill(ego, 0.0)
        found.append(Evidence(odds.sigmoid(), weight))
    return found


def _passed(seen: Sequence[Observation]) -> list[Past]:
    """What is known after each frame, of those before it."""
    settings, passed = SteadySettings(), []
    for one in seen:
        passed.append(recalled(passed[-1] if passed else None, one, settings))
    return passed


def _at_size(plane: Tensor, like: Tensor) -> Tensor:
    """A plane (h,w) at the size of another one, averaged."""
    return F.adaptive_avg_pool2d(plane[None], (like.shape[0], like.shape[1]))[0]


# --- both ---------------------------------------------------------------------------------------


class FootageEvidence(NamedTuple):
    """What footage knows of its frames, and in words what could not be had, and why.

    teachers: for each frame "path" and "time".
    """

    teachers: list[dict[str, Evidence]]
    words: list[str]


def footage_evidence(frames: Sequence[Tensor], likelihoods: Sequence[Tensor]) -> FootageEvidence:
    """What one camera's frames (3,H,W) in [0,1], in order, know of one another.

    likelihoods: a detector's, (h,w) in [0,1], all of one size, that of the maps: about 160 pixels
    across. Of long footage give a few hundred frames at a time, the next ones with the last
    ``OVERLAP`` again: memory is linear in them. What cannot be had has weight 0 and a word.
    """
    size = (likelihoods[0].shape[0], likelihoods[0].shape[1]) if likelihoods else (1, 1)
    silent = [{"path": nothing(size), "time": nothing(size)} for _ in frames]
    if len({tuple(frame.shape) for frame in frames}) > 1:
        return FootageEvidence(silent, ["frames of several sizes: nothing that joins them"])
    if len(frames) < FRAMES:
        return FootageEvidence(silent, [f"{len(frames)} frames: {FRAMES} at the least"])
    greys = [flow_picture(frame, WIDTH) for frame in frames]
    found = still_ego(frames[:: max(1, len(frames) // LOOKS)])
    ego = torch.zeros(greys[0].shape) if found is None else found.to(torch.float32)
    ego = _around(_scaled(ego, (greys[0].shape[0], greys[0].shape[1])) > 0.5)
    roads = [_scaled(one, (ego.shape[0], ego.shape[1])) * ~ego for one in likelihoods]
    drive = drive_of(greys, roads, guess_of(frames[:: max(1, len(frames) // LOOKS)]))
    small_ego = _scaled(ego.to(torch.float32), size) > 0
    path = path_evidence(drive, size, small_ego)
    time = time_evidence(greys, likelihoods, small_ego)
    teachers = [{"path": path.get(at, nothing(size)), "time": one} for at, one in enumerate(time)]
    return FootageEvidence(teachers, drive.words)


def _scaled(plane: Tensor, size: tuple[int, int]) -> Tensor:
    """A plane (h,w) at another size, between pixels."""
    return F.interpolate(plane[None, None], size, mode="bilinear")[0, 0]


def _around(ego: Tensor) -> Tensor:
    """An ego car bool (h,w) and what is close above it: its edge is known to some pixels."""
    reach = ego.shape[0] // 25
    wider = F.max_pool2d(ego[None].to(torch.float32), 2 * reach + 1, 1, reach)[0]
    return wider > 0


def guess_of(frames: Sequence[Tensor]) -> Mount:
    """The mount of the camera of frames (3,H,W), by where the lines of the pictures meet."""
    size = small_size(frames)
    point = vanishing_point(gradients(small_grey(frame, size) for frame in frames))
    height, width = frames[0].shape[-2:]
    down_by = (0.5 - point.row) * height / width / FOCAL
    return Mount(math.atan(down_by), math.atan((point.column - 0.5) / FOCAL))
