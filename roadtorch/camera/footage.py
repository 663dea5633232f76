"""A camera from its footage: what stays the same in some dozens of frames, and what forbids it."""

from collections import Counter
from collections.abc import Iterable, Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.camera.camera import SAME_SHAPE, Camera
from roadtorch.camera.look import Look, ego_look, gradient_likeness, sure_look
from roadtorch.camera.still import gradients, small_grey, small_size, softened, stillness
from roadtorch.camera.still_ego import EARLIEST, Footage, ego_rows, look_through
from roadtorch.camera.vanishing_point import VanishingPoint, crossing, road_lines
from roadtorch.errors import InputError
from roadtorch.road.ego import Ego

FEWEST = 5
"""Frames; fewer have edges in common by chance."""

COLUMNS = 64
"""Columns of the outline in a camera's file."""

STANDS = 0.85
"""Share of common gradients from which nothing moves. Straight motorways have up to .7."""

OWN, FOREIGN = 0.8, 0.35
"""Likeness to the ego car of some frames that four of five others of them have at least, and that
four of five frames of another camera have at most."""

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
    _check_looks(footage, found, where)
    rows = ego_rows(footage)
    look = Look() if rows is None else sure_look(ego_look(footage.still, rows), found)
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


def _check_looks(footage: Footage, found: list[Tensor], where: str) -> None:
    """InputError when one half of the frames shows an ego car that the other lacks."""
    halves = halved(footage, found)
    for shown, lacking in (halves, halves[::-1]):
        if _is_foreign(footage.point, *([found[at] for at in half] for half in (shown, lacking))):
            some = ", ".join(str(at + 1) for at in lacking[:5])
            what = (
                f"is of several cameras: {len(lacking)} of {len(found)} frames do not show "
                f"the ego car of the others, such as number {some}"
            )
            raise InputError(where, what, "give the footage of one")


def _is_foreign(point: VanishingPoint, half: list[Tensor], other: list[Tensor]) -> bool:
    """Whether frames have an ego car in common that others lack; gradients (2,h,w) of both."""
    if min(len(half), len(other)) < FEWEST:
        return False
    still = stillness(half)
    rows = ego_rows(Footage(still, point, road_lines(half, point)))
    if rows is None:
        return False
    # Each is compared with frames that it is not among.
    odd, even = (ego_look(stillness(part), rows) for part in (half[::2], half[1::2]))
    own = [*_likenesses(odd, half[1::2]), *_likenesses(even, half[::2])]
    strange = _likenesses(ego_look(still, rows), other)
    return _quantile(own, 0.2) >= OWN and _quantile(strange, 0.8) <= FOREIGN


def _likenesses(look: Look, found: Iterable[Tensor]) -> list[float]:
    return [gradient_likeness(look, gradient) for gradient in found]


def _quantile(values: list[float], share: float) -> float:
    return float(torch.tensor(values).quantile(share))


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
