"""How a camera moves over flat ground, by corners that stand still and by what the ground shows.

Between two frames the picture of a plane moves by a homography, R + t nᵀ/h (Hartley and Zisserman,
Multiple View Geometry, 2004, eq. 13.2). A vehicle moves where it heads: the plane's normal n and
the heading are the same in all frames of a camera, and only how far it went and how it turned are
each pair's own. Lengths are in heights of the camera, which nobody knows; nor does anybody know
the lens, and one of usual width is assumed: it only bends the flow of turns.

Rays are x right, y down, 1 along the optical axis; rows and columns are pixels.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

FOCAL = 0.8
"""Focal length in widths of the picture: 64° from side to side."""

WIDTH = 320
"""Pixels across frames in which motion is looked for; what is said in pixels is of such."""

CORNERS, APART = 300, 5
"""Corners of a frame that are followed, and pixels between them at the least."""

ROUND_TRIP = 1.0
"""Pixels by which a corner followed there and back may miss where it began."""

NOISE = 0.3
"""Pixels by which a followed corner is off as a rule."""

STEPS = 12
"""Of Gauss and Newton; the last change a corner's place by less than 1e-3 of a pixel."""

AIM, TURN = 0.1, 0.03
"""Radians: standard deviations of the mount about what lines of the picture say, and of a turn
between two frames about none. Few corners decide against them, no corner leaves them."""

FORWARD = tuple(0.08 * 1.12**step for step in range(32))
"""Heights of the camera that a vehicle may go from frame to frame: 11 cm to 3.8 m for a car's."""

HURRY = 200.0
"""Nats that it costs to go e times as far as in the pair before; squared for more or less."""

AROUND = 15
"""Pixels about which brightness is levelled, so that light and exposure do not count."""

GRAIN, LEVELS = 3.0, 12.0
"""Grey levels by which the same place may differ, and how many more make it altogether another:
what a codec leaves of plain tarmac stands still in the picture."""

SHARP = 1e-3
"""Smaller eigenvalue of the structure tensor, as OpenCV scales it, of a corner half believed."""

STRAY = 0.05
"""How likely a corner on likely road is none of the ground, beside one that fits it."""

TILT = 0.008
"""Radians by which a vehicle nods, and roads bend upwards, as a rule."""

PATCH = 25.0
"""Pixels that say together what one would say alone."""

FRAMES, KEYS, FEWEST = 10, 5, 25
"""Frames of a drive, keys among them, and corners of a pair at the least."""

MOVED, NEAR_SHARE = 1.5, 0.25
"""Pixels by which this share of the corners must move from key to key: the rest may be far off."""

AGREE, KNOWN = 0.6, 2.0
"""Share of corners that stand still in the world, and nats by which a way beats others in
the mean over nine pairs, at the least."""

NEAR_HORIZON = 0.03
"""Heights over distance from which on ground is near enough to tell."""


class Mount(NamedTuple):
    """What the frames of one camera share, radians: it looks down by pitch, drives to heading.

    heading: positive where the vehicle moves to the right of where the camera looks.
    """

    pitch: float
    heading: float


class Tracks(NamedTuple):
    """Corners followed from one frame to another: rays here and there (n,2), weight (n,).

    sharp: from 0 on a line or a plain surface, along which a corner slides, to 1, (n,).
    """

    here: Tensor
    there: Tensor
    weight: Tensor
    sharp: Tensor


class Turns(NamedTuple):
    """How the camera turned between the frames of p pairs: angles (p,3), share that agrees (p,).

    Angles are yaw to the right, pitch down and roll clockwise, in radians.
    """

    angles: Tensor
    fit: Tensor


def rays(height: int, width: int) -> Tensor:
    """The rays (h,w,3) of the pixels of a picture, float32."""
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    right, down = (columns - (width - 1) / 2), (rows - (height - 1) / 2)
    return torch.stack([right, down, torch.full_like(right, FOCAL * width)], -1) / (FOCAL * width)


def down(mount: Tensor) -> Tensor:
    """The unit vector (3,) to the ground below a camera of pitch and heading (2,)."""
    zero = torch.zeros_like(mount[0])
    return torch.stack([zero, mount[0].cos(), mount[0].sin()])


def way(mount: Tensor) -> Tensor:
    """The unit vector (3,) along which the vehicle drives."""
    (pitch, heading), zero = mount, torch.zeros_like(mount[0])
    ahead = torch.stack([zero, -pitch.sin(), pitch.cos()])
    right = torch.stack([zero + 1, zero, zero])
    return heading.cos() * ahead + heading.sin() * right


def rotation(angles: Tensor) -> Tensor:
    """What the scene does (…,3,3) when the camera turns by yaw, pitch, roll (…,3)."""
    yaw, pitch, roll = angles.unbind(-1)
    zero = torch.zeros_like(yaw)
    parts = [zero, roll, -yaw, -roll, zero, -pitch, yaw, pitch, zero]
    return torch.linalg.matrix_exp(torch.stack(parts, -1).unflatten(-1, (3, 3)))


# --- turns and mount ----------------------------------------------------------------------


def followed(here: Tensor, there: Tensor) -> Tracks:
    """Corners of a frame uint8 (h,w) found again in another one (Lucas and Kanade, pyramids)."""
    one, other = here.numpy(), there.numpy()
    corners = cv2.goodFeaturesToTrack(one, CORNERS, 0.003, APART)
    height, width = one.shape
    middle, focal = np.array([(width - 1) / 2, (height - 1) / 2]), FOCAL * width
    points, (weight, sharp) = np.zeros((2, CORNERS, 2)), np.zeros((2, CORNERS))
    if corners is not None:
        window: Any = {"winSize": (15, 15), "maxLevel": 4, "nextPts": None}
        found, ok, _ = cv2.calcOpticalFlowPyrLK(one, other, corners, **window)
        back, ok_back, _ = cv2.calcOpticalFlowPyrLK(other, one, found, **window)
        missed = np.linalg.norm(back - corners, axis=-1)[:, 0]
        n = len(corners)
        points[0, :n], points[1, :n] = corners[:, 0], found[:, 0]
        strength = cv2.cornerMinEigenVal(one, 7)[tuple(corners[:, 0].T[::-1].astype(int))]
        sharp[:n] = strength / (strength + SHARP)
        weight[:n] = (ok[:, 0] > 0) & (ok_back[:, 0] > 0) & (missed < ROUND_TRIP)
    points = torch.from_numpy((points - middle) / focal)
    return Tracks(points[0], points[1], torch.from_numpy(weight), torch.from_numpy(sharp))


def off_course(tracks: Tracks, angles: Tensor, mount: Tensor) -> Tensor:
    """How far corners (p,n) end beside the lines on which what stands still can only move.

    In radians, about. tracks: p pairs in one. angles: of p turns (p,3). mount: (2,). Without the
    turn, all lines meet where the vehicle heads.
    """
    away = F.pad(tracks.there, (0, 1), value=1.0) @ rotation(angles)
    away = away[..., :2] / away[..., 2:]
    aim = way(mount)
    radius = tracks.here - aim[:2] / aim[2]
    move = away - tracks.here
    cross = radius[..., 0] * move[..., 1] - radius[..., 1] * move[..., 0]
    return cross / radius.norm(dim=-1).clamp_min(0.02)


def fitted(tracks: Tracks, guess: Mount) -> tuple[Turns, Mount]:
    """Turns of p pairs and the mount that all share, by tracks of them all, each (p,n,…).

    Robust least squares (weights of Geman and McClure) from no turn and the mount that lines of
    the picture say. What moves by itself is one outlier among many that stand.
    """
    pairs = len(tracks.weight)
    angles, start = torch.zeros(pairs, 3).double(), torch.tensor(guess).double()
    mount, unit = start, NOISE / (FOCAL * WIDTH)
    for step in range(STEPS):
        loose = 9.0 * 4.0 ** max(0, 4 - step)
        angles, mount = _improved(tracks, angles, mount, start, unit, loose)
    missed = off_course(tracks, angles, mount) / unit
    fit = (tracks.weight * (missed.square() < 9)).sum(1) / tracks.weight.sum(1).clamp_min(1)
    return Turns(angles.float(), fit.float()), Mount(*mount.tolist())


def _improved(
    tracks: Tracks, angles: Tensor, mount: Tensor, start: Tensor, unit: float, loose: float
) -> tuple[Tensor, Tensor]:
    """One step of Gauss and Newton for the angles (p,3) of pairs and the mount (2,) of all.

    The pairs' own numbers are eliminated first (Schur's complement; Hartley and Zisserman, A6.3).
    """
    small = 1e-5 * torch.eye(3).double()
    now = off_course(tracks, angles, mount)
    slopes = [off_course(tracks, angles + small[at], mount) - now for at in range(3)]
    slopes += [off_course(tracks, angles, mount + small[at, :2]) - now for at in range(2)]
    slope, now = torch.stack(slopes, -1) / 1e-5 / unit, now / unit
    weighted = slope * (tracks.weight / (1 + now.square() / loose).square())[..., None]
    curve, pull = weighted.mT @ slope, weighted.mT @ now[..., None]
    own = curve[:, :3, :3] + torch.eye(3) / TURN**2
    own_pull = pull[:, :3] + angles[..., None] / TURN**2
    cross = curve[:, :3, 3:]
    solved = torch.linalg.solve(own, torch.cat([cross, own_pull], -1))
    whole = (curve[:, 3:, 3:] - cross.mT @ solved[..., :2]).sum(0) + torch.eye(2) / AIM**2
    rest = (pull[:, 3:] - cross.mT @ solved[..., 2:]).sum(0) + (mount - start)[:, None] / AIM**2
    change = -torch.linalg.solve(whole, rest)
    return angles - solved[..., 2] - (solved[..., :2] @ change)[..., 0], mount + change[:, 0]


# --- how far --------------------------------------------------------------------------------


def plane_homography(turn: Tensor, move: Tensor, mount: Mount, closer: float = 1.0) -> Tensor:
    """How rays to a level plane move, (…,3,3), when points move by turn (…,3,3) and move (…,3).

    closer: how many times as far the ground is below the camera as the plane; 1 is the ground, 2
    half way up to the camera, 0 infinitely far. Lengths are heights of the camera.
    """
    return turn + closer * move[..., :, None] * down(torch.tensor(mount)).to(turn)


def seen_from(there: Tensor, homography: Tensor) -> Tensor:
    """What a frame float32 (h,w) shows where a homography (3,3) of rays points; NaN outside."""
    height, width = there.shape
    focal = FOCAL * width
    lens = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    pixels = lens @ homography.double().numpy() @ np.linalg.inv(lens)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (width, height)
    nothing = float("nan")
    warped = cv2.warpPerspective(there.numpy(), pixels, size, flags=flags, borderValue=nothing)
    return torch.from_numpy(warped)


def levelled(grey: Tensor) -> Tensor:
    """A frame uint8 (h,w) without its brightness: float32 levels about the mean around."""
    plain = grey.numpy().astype(np.float32)
    return torch.from_numpy(plain - cv2.blur(plain, (AROUND, AROUND)))


def difference(here: Tensor, seen: Tensor) -> Tensor:
    """How unlike two levelled frames (h,w) are, 0 to 1 for each pixel; NaN where one has none."""
    return (((here - seen).abs() - GRAIN) / LEVELS).clamp(0.0, 1.0)


def forward_costs(here: Tensor, there: Tensor, turn: Tensor, mount: Mount, road: Tensor) -> Tensor:
    """What speaks against each of ``FORWARD`` (k,), in nats: ground that looks another there.

    here, there: levelled frames (h,w). turn: (3,3). road: how likely ground, (h,w) in [0,1]. What
    leaves the picture is neither for nor against; nor is what looks the same had nobody moved:
    plain tarmac, lines along the way, dirt on the glass.
    """
    aim = turn @ way(torch.tensor(mount))
    planes = (plane_homography(turn, -forward * aim, mount) for forward in FORWARD)
    unlike = torch.stack([difference(here, seen_from(there, plane)) for plane in planes])
    against = (unlike - unlike.nanmean(0)).nan_to_num()
    changed = difference(here, seen_from(there, turn)).nan_to_num()
    return (against * changed * road).sum((1, 2)) / PATCH


def corner_costs(tracks: Tracks, turns: Turns, mount: Mount, road: Tensor) -> Tensor:
    """What speaks against each of ``FORWARD`` in p pairs (p,k), in nats: corners of the ground.

    road: how likely ground each corner is, (p,n). A corner below the horizon tells how far the
    vehicle went, were it ground; one in ``STRAY`` is not.
    """
    shared = torch.tensor(mount).double()
    aim, focal = way(shared), FOCAL * WIDTH
    away = F.pad(tracks.there, (0, 1), value=1.0) @ rotation(turns.angles.double())
    before = (tracks.here - aim[:2] / aim[2]).norm(dim=-1).clamp_min(1e-6)
    after = (away[..., :2] / away[..., 2:] - aim[:2] / aim[2]).norm(dim=-1).clamp_min(1e-6)
    below = (F.pad(tracks.here, (0, 1), value=1.0) @ down(shared)).clamp_min(1e-6)
    nearing = 1 - before / after
    forward = nearing / below
    noise = NOISE / focal / after / below
    doubt = torch.hypot(noise, forward * TILT / below).clamp_min(1e-6)
    has_moved = (after - before).abs() * focal > ROUND_TRIP
    weight = tracks.weight * tracks.sharp * road * (below > NEAR_HORIZON) * has_moved
    ways = torch.tensor(FORWARD).double()
    off = (forward[..., None] - ways) / torch.hypot(doubt[..., None], 0.05 * ways)
    likely = (1 - STRAY) * (-off.square() / 2).exp() + STRAY
    return -(weight[..., None] * likely.log()).sum(1)


def smoothest(costs: Tensor) -> Tensor:
    """Which of k ways each of p pairs goes, int64 (p,): the least cost (p,k) without haste.

    Viterbi's algorithm; ``HURRY`` is what a change costs.
    """
    ways = torch.tensor(FORWARD).log()
    change = HURRY * (ways[:, None] - ways[None]).square()
    total, came = costs[0], []
    for cost in costs[1:]:
        best = (total[:, None] + change).min(0)
        came.append(best.indices)
        total = best.values + cost
    chosen = [int(total.argmin())]
    for before in reversed(came):
        chosen.append(int(before[chosen[-1]]))
    return torch.tensor(chosen[::-1])


# --- the drive ------------------------------------------------------------------------------


class Drive(NamedTuple):
    """How a camera went through n frames.

    keys: numbers of the k frames between which it moved enough to tell. turn (k-1,3,3) and move
    (k-1,3): points of one key's camera in the next one's, lengths in heights of the camera; NaN
    where it cannot be told. words: what could not be had, and why.
    """

    keys: list[int]
    turn: Tensor
    move: Tensor
    mount: Mount
    words: list[str]


def key_frames(greys: Sequence[Tensor]) -> tuple[list[int], list[Tracks]]:
    """Frames uint8 (h,w) far enough apart, and the corners followed from each to the next."""
    keys, tracks = [0], []
    for at in range(1, len(greys)):
        found = followed(greys[keys[-1]], greys[at])
        sure = found.weight > 0
        way_gone = (found.there - found.here).norm(dim=-1)[sure] * FOCAL * greys[0].shape[1]
        if sure.sum() < FEWEST or way_gone.quantile(1 - NEAR_SHARE) >= MOVED:
            keys.append(at)
            tracks.append(found)
    return keys, tracks


def drive_of(greys: Sequence[Tensor], roads: Sequence[Tensor], guess: Mount) -> Drive:
    """How the camera of frames uint8 (h,w), in order, went over the ground.

    roads: how likely each pixel is road, (h,w) in [0,1]. guess: what lines of the picture say of
    the mount.
    """
    keys, found = key_frames(greys)
    nowhere = torch.full((len(keys) - 1, 3, 3), float("nan"))
    still = Drive(keys, nowhere, nowhere[..., 0], guess, [])
    if len(greys) < FRAMES:
        return still._replace(words=[f"{len(greys)} frames: too few to tell where it went"])
    if len(keys) < KEYS:
        return still._replace(words=["stands still, or nearly: nothing tells where it went"])
    tracks = Tracks(*(torch.stack(part) for part in zip(*found, strict=True)))
    height, width = greys[0].shape
    turns, mount = fitted(tracks, guess)
    sure = (turns.fit >= AGREE) & (tracks.weight.sum(1) >= FEWEST)
    words = [] if sure.all() else [f"{int((~sure).sum())} cuts or jumps: nothing beyond them"]
    if sure.sum() < len(sure) / 2:
        return still._replace(words=["pictures do not follow one another: nothing of motion"])
    below = rays(height, width) @ down(torch.tensor(mount)) > NEAR_HORIZON
    ground = [roads[key] * below for key in keys]
    turn = rotation(turns.angles)
    light = [levelled(greys[key]) for key in keys]
    costs = torch.stack(
        [
            forward_costs(here, there, one, mount, road)
            for here, there, one, road in zip(light, light[1:], turn, ground, strict=False)
        ]
    )
    at_corners = torch.stack(
        [at_rays(road, here) for road, here in zip(ground, tracks.here, strict=False)]
    )
    costs = costs + corner_costs(tracks, turns, mount, at_corners)
    costs = costs.where(sure[:, None], 0.0)
    chosen = smoothest(costs)
    known = costs.median(1).values - costs.gather(1, chosen[:, None])[:, 0]
    around = F.avg_pool1d(known[None], 9, 1, 4, count_include_pad=False)[0]
    untold = sure & (around < KNOWN)
    if untold.any():
        words.append(f"{int(untold.sum())} times the ground does not tell how far it went")
    forward = torch.tensor(FORWARD)[chosen]
    move = -forward[:, None] * (turn @ way(torch.tensor(mount)))
    unknown = ~sure | untold
    turn[unknown], move[unknown] = float("nan"), float("nan")
    return Drive(keys, turn, move, mount, words)


def at_rays(plane: Tensor, points: Tensor) -> Tensor:
    """A plane (h,w) at rays (n,2), between pixels; 0 outside."""
    height, width = plane.shape
    pixels = points.to(plane) * FOCAL * width * 2
    places = pixels / torch.tensor([width, height])
    return F.grid_sample(plane[None, None], places[None, None], align_corners=False)[0, 0, 0]
