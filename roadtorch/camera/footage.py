"""A camera from its footage: what stays the same in some dozens of frames, and what forbids it."""

from collections import Counter
from collections.abc import Iterable, Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.camera.camera import SAME_SHAPE, Camera
from roadtorch.camera.look import LEAST, Look, ego_look, gradient_likeness, sure_look
from roadtorch.camera.still import gradients, small_grey, small_size, softened
from roadtorch.camera.still_ego import EARLIEST, Footage, ego_rows, look_through
from roadtorch.camera.vanishing_point import crossing
from roadtorch.ego import Ego
from roadtorch.errors import InputError

FEWEST = 5
"""Frames; fewer have edges in common by chance."""

COLUMNS = 64
"""Columns of the outline in a camera's file."""

STANDS = 0.85
"""Share of common gradients from which nothing moves. Straight motorways have up to .7."""

FOREIGN = 1 / 3
"""Share of the frames that may lack the ego car before they are of several cameras."""

MIDDLE = slice(COLUMNS * 3 // 8, COLUMNS * 5 // 8)
"""Columns of the outline over which the seed row is taken: those of the seed area."""


def camera_of(frames: Iterable[Tensor], where: str = "footage") -> Camera:
    """The camera that took the frames (3,H,W), floating point in [0,1], 10 to some hundred.

    They are gone through once, and may be large. Raises InputError naming ``where`` for too few
    frames, frames that stand still, and frames of several cameras (their shapes differ, or
    there are two unlike ego cars).
    """
    sizes, greys = [], []
    for frame in frames:
        sizes.append((frame.shape[-2], frame.shape[-1]))
        greys.append(small_grey(frame, small_size([frame])))
    _check_number(sizes, where)
    _check_shapes(sizes, where)
    found = list(gradients(at_one_size(greys)))
    footage = look_through(found)
    if footage.still.share >= STANDS:
        raise InputError(where, "stands still: nothing moves", "give footage of a drive")
    rows = ego_rows(footage)
    look = Look() if rows is None else sure_look(ego_look(footage.still, rows), found)
    _check_looks(look, footage, found, where)
    return _camera(footage, rows, look, Counter(sizes).most_common(1)[0][0])


def at_one_size(greys: Sequence[Tensor]) -> list[Tensor]:
    """Small grey pictures (h,w) of nearly the same shape, all at the median one."""
    size = small_size(greys)
    return [
        F.interpolate(grey[None, None], size, mode="bilinear")[0, 0]
        if tuple(grey.shape) != size
        else grey
        for grey in greys
    ]


def _camera(footage: Footage, rows: Tensor | None, look: Look, size: tuple[int, int]) -> Camera:
    """The camera of what was found; size: height and width of most of its frames."""
    height, width = size
    outline = () if rows is None else outline_of(rows, footage.still.length.shape[0])
    return Camera(
        width=width,
        height=height,
        frames=footage.still.frames,
        horizon=round(footage.point.row, 3),
        seed_row=min(outline[MIDDLE], default=1.0),
        ego=Ego(outline=outline),
        look=look,
    )


def outline_of(rows: Tensor, height: int) -> tuple[float, ...]:
    """An outline as ``Ego`` has it, of rows (w,) int64 in a picture of that height."""
    shares = F.adaptive_avg_pool1d(rows[None].to(torch.float64) / height, COLUMNS)[0]
    return tuple(round(share, 4) for share in shares.tolist())


# --- what forbids it --------------------------------------------------------------------


def _check_number(sizes: Sequence[tuple[int, int]], where: str) -> None:
    if len(sizes) < FEWEST:
        number = "one frame" if len(sizes) == 1 else f"{len(sizes)} frames"
        raise InputError(where, f"has {number}", "give 10 or more, of different places")


def _check_shapes(sizes: Sequence[tuple[int, int]], where: str) -> None:
    """InputError when the frames' aspect ratios differ more than one camera's do."""
    shapes = sorted(set(sizes), key=lambda size: size[1] / size[0])
    (low_height, low_width), (height, width) = shapes[0], shapes[-1]
    if width / height > SAME_SHAPE * low_width / low_height:
        what = f"is of several cameras: {low_width}×{low_height} and {width}×{height} pixels"
        raise InputError(where, what, "give the footage of one")


def _check_looks(look: Look, footage: Footage, found: list[Tensor], where: str) -> None:
    """InputError when many frames lack the ego car, or one half has one that the other lacks."""
    if look.rows:
        unlike = _unlike(look, found)
        several = unlike > FOREIGN * len(found)
    else:
        halves = [[found[at] for at in half] for half in halved(footage, found)]
        several = any(_is_foreign(*pair) for pair in (halves, halves[::-1]))
    if several:
        what = "is of several cameras: part of the frames shows another ego car, or none"
        raise InputError(where, what, "give the footage of one")


def _unlike(look: Look, found: Iterable[Tensor]) -> int:
    """How many frames do not have that look."""
    return sum(gradient_likeness(look, gradient) < LEAST for gradient in found)


def _is_foreign(half: list[Tensor], other: list[Tensor]) -> bool:
    """Whether one half of the frames has an ego car that most of the other lack."""
    if min(len(half), len(other)) < FEWEST:
        return False
    footage = look_through(half)
    rows = ego_rows(footage)
    return rows is not None and 2 * _unlike(ego_look(footage.still, rows), other) > len(other)


def halved(footage: Footage, found: Sequence[Tensor]) -> tuple[list[int], list[int]]:
    """The frames' numbers in two groups, each alike at the bottom: what two cameras would be.

    The sign of the first principal component of the softened gradients that are no road lines.
    """
    top = round(EARLIEST * found[0].shape[1])
    weight = crossing(footage.still.direction, footage.point)
    low = torch.stack([(softened(one) * weight)[:, top:].reshape(-1) for one in found])
    centred = low - low.mean(0)
    first = torch.linalg.eigh(centred @ centred.T)[1][:, -1]
    numbers = range(len(found))
    return [n for n in numbers if first[n] > 0], [n for n in numbers if first[n] <= 0]
