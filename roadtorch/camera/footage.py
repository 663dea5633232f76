"""Estimation of a camera from some dozens of its frames."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.errors import InputError
from roadtorch.camera.camera import (
    MAX_LIKENESS,
    MIN_LIKENESS,
    SAME_SHAPE,
    Camera,
    EgoLook,
    ego_look,
    likenesses,
    rounded,
)
from roadtorch.camera.gradients import (
    Stillness,
    VanishingPoint,
    crossing,
    gradient_of,
    road_lines,
    small_grey,
    small_size,
    softened,
    stillness,
    vanishing_point,
)
from roadtorch.imaging.resize import at_image_size, size_of
from roadtorch.road.ego import Ego

# --- the ego car below an edge that never moves ---------------------------------------


NEUTRAL_EVIDENCE = 0.35  # evidence of an edge at which a column neither gains nor loses

MIN_EVIDENCE = 0.08
"""Evidence above NEUTRAL_EVIDENCE, averaged over all columns, from which there is an ego car."""

MAX_CLIMB, CLIMB_COST = 3, 0.15  # rows by which a path may climb in a column, and what each costs

NEXT_EDGE = 0.6
"""Fraction of the best path's evidence that an edge above needs to be the ego car's as well."""

MAX_EDGE_DISTANCE = 0.15  # share of the height within which an edge above belongs to the same car
MIN_APART = 3  # rows between two edges: less is the same edge, blurred

MIN_EGO_ROW, BELOW_HORIZON = 0.6, 0.12
"""Fractions of the height: an ego car begins below the first, and at least the second below the
vanishing point.
"""

MIN_EGO_HEIGHT = 0.02
"""Fraction of the height; a strip that is nowhere higher is a border of the image, or noise."""

MAX_ROAD_LINES = 0.45
"""Fraction of slanting edges that aim at the vanishing point, from which a region is road. About
.1 to .3 on bonnets, .4 to .9 on roads with lanes; chance is .16.
"""


class Footage(NamedTuple):
    """Gradient statistics of frames of one camera, at the reduced size (h, w).

    lines: (2, h, w), strength of edges that aim at the vanishing point, and of all.
    """

    still: Stillness
    point: VanishingPoint
    lines: Tensor


def still_ego(frames: Sequence[Tensor]) -> Tensor | None:
    """Detect the ego car in frames of one camera.

    Args:
        frames: sRGB in [0, 1], shape (3, H, W) each; sizes may differ. 10 of different places are
            enough, more are better.

    Returns:
        Mask, bool, of the size of the first frame; None without an ego car, which is common.

    Raises:
        InputError: for fewer than two frames.
    """
    if len(frames) < 2:
        raise InputError("footage", f"is {len(frames)} frame(s)", "give 10 or more of one camera")
    size = small_size(frames)
    rows = ego_rows(look_through([gradient_of(small_grey(frame, size)) for frame in frames]))
    if rows is None:
        return None
    below = torch.arange(size[0])[:, None] >= rows
    return at_image_size(below, size_of(frames[0]))


def look_through(gradients: Sequence[Tensor]) -> Footage:
    """Return the statistics of the gradients (2, h, w) of two or more frames."""
    point = vanishing_point(gradients)
    return Footage(stillness(gradients), point, road_lines(gradients, point))


def ego_rows(footage: Footage) -> Tensor | None:
    """Return the row (w,) int64 where the ego car begins in each column (h: none), or None.

    The best path of a static edge that has no road below; then the next nearly as good one close
    above, as long as there is one: a bonnet has several edges, and wipers before it.
    """
    evidence = edge_evidence(footage.still, footage.point)
    height, row = len(evidence), torch.arange(len(evidence))[:, None]
    rows, gained = best_path(evidence)
    while gained >= MIN_EVIDENCE and _is_road(footage.lines, row >= rows + MIN_APART):
        # A reflection in the windscreen, or the road's own texture: look further down.
        rows, gained = best_path(evidence * (row > rows + MIN_APART))
    if gained < MIN_EVIDENCE:
        return None
    while (above := _edge_above(footage.lines, evidence, rows, gained)) is not None:
        rows = above
    return rows if height - int(rows.min()) >= MIN_EGO_HEIGHT * height else None


def _edge_above(lines: Tensor, evidence: Tensor, rows: Tensor, enough: float) -> Tensor | None:
    """Return the rows (w,) of an edge close above that belongs to the ego car; None without one."""
    height, row = len(evidence), torch.arange(len(evidence))[:, None]
    close = (row < rows - MIN_APART) & (row >= rows - MAX_EDGE_DISTANCE * height)
    above, gained = best_path(evidence * close)
    higher = torch.minimum(rows, above)
    between = (row >= higher + MIN_APART) & (row < rows - MIN_APART)
    is_edge = gained >= max(MIN_EVIDENCE, NEXT_EDGE * enough) and not _is_road(lines, between)
    return higher if is_edge else None


def _is_road(lines: Tensor, where: Tensor) -> bool:
    """Return whether the edges in a region bool (h, w) aim at the vanishing point."""
    aiming, every = (float(strength[where].sum()) for strength in lines)
    return aiming > MAX_ROAD_LINES * every


def edge_evidence(still: Stillness, point: VanishingPoint) -> Tensor:
    """Return the evidence of static edges that are no lines of the road: (h, w) in [0, 1]."""
    direction = still.direction
    evidence = still.coherence * crossing(direction, point) * direction[1].abs()
    height = len(evidence)
    evidence[: round(max(MIN_EGO_ROW, point.row + BELOW_HORIZON) * height)] = 0
    return F.max_pool2d(evidence[None, None], (3, 1), 1, (1, 0))[0, 0]


def best_path(evidence: Tensor) -> tuple[Tensor, float]:
    """Return the path across evidence (h, w) of the largest gain: row (w,) int64, and the gain.

    Row h, below the image, is free; the gain is the evidence above NEUTRAL_EVIDENCE, averaged over
    the columns. Dynamic programming over the columns.
    """
    height, width = evidence.shape
    gain = torch.cat([evidence - NEUTRAL_EVIDENCE, evidence.new_zeros(1, width)])
    steps = torch.arange(-MAX_CLIMB, MAX_CLIMB + 1)
    cost = CLIMB_COST * steps.abs()[:, None]
    total, came = gain[:, 0], []
    for column in range(1, width):
        padded = F.pad(total, (MAX_CLIMB, MAX_CLIMB), value=-torch.inf)
        best = (padded.unfold(0, height + 1, 1) - cost).max(0)
        total = best.values + gain[:, column]
        came.append(torch.arange(height + 1) + steps[best.indices])
    row = int(total.argmax())
    rows = [row]
    for back in reversed(came):
        rows.append(row := int(back[row]))
    return torch.tensor(rows[::-1]), float(total.max()) / width


# --- the camera ------------------------------------------------------------------------

MIN_FRAMES = 5  # frames; fewer have edges in common by chance
OUTLINE_COLUMNS = 64  # columns of the outline in a camera's file

STILL_SHARE = 0.85
"""Fraction of common gradients from which nothing moves. Straight motorways reach .7."""

OWN_LIKENESS, FOREIGN_LIKENESS = 0.8, 0.35
"""Similarity to the ego car of some frames: reached by four of five other frames of the camera, and
not exceeded by four of five frames of another camera.
"""

MIDDLE = slice(OUTLINE_COLUMNS * 3 // 8, OUTLINE_COLUMNS * 5 // 8)
"""Columns of the outline over which the seed row is computed: those of the seed area."""


class StillError(InputError):
    """Footage in which nothing moves."""


def camera_of(frames: Iterable[Tensor], where: str = "footage") -> Camera:
    """Estimate the camera from frames that it recorded.

    Args:
        frames: sRGB in [0, 1], shape (3, H, W) each, 10 to some hundred; iterated over once.
        where: names the footage in errors.

    Raises:
        StillError: for footage in which nothing moves.
        InputError: for too few frames, and for several cameras (of different shapes, or with an ego
            car in one part of the frames only).
    """
    sizes, greys = [], []
    for frame in frames:
        sizes.append(size_of(frame))
        greys.append(small_grey(frame, small_size([frame])))
    if len(sizes) < MIN_FRAMES:
        number = "one frame" if len(sizes) == 1 else f"{len(sizes)} frames"
        raise InputError(where, f"has {number}", "give 10 or more, of different places")
    shapes = sorted(set(sizes), key=lambda size: size[1] / size[0])
    (low_height, low_width), (height, width) = shapes[0], shapes[-1]
    if width / height > SAME_SHAPE * low_width / low_height:
        problem = f"is of several cameras: {low_width}×{low_height} and {width}×{height} pixels"
        raise InputError(where, problem, "give the footage of one")
    size = small_size(greys)
    gradients = [
        gradient_of(F.interpolate(grey[None, None], size, mode="bilinear")[0, 0]) for grey in greys
    ]
    footage = look_through(gradients)
    if footage.still.share >= STILL_SHARE:
        raise StillError(where, "stands still: nothing moves", "give footage of a drive")
    _check_looks(footage, gradients, where)
    rows = ego_rows(footage)
    look, outline = EgoLook(), ()
    if rows is not None:
        look = ego_look(footage.still, rows)
        # Three fifths of what four images of five exceed: those to come differ more than these.
        usual = float(likenesses(look, gradients).quantile(0.2))
        least = min(MAX_LIKENESS, max(MIN_LIKENESS, 0.6 * usual))
        look = look.model_copy(update={"least": round(least, 3)})
        shares = F.adaptive_avg_pool1d(rows[None].to(torch.float64) / size[0], OUTLINE_COLUMNS)[0]
        outline = rounded(shares, 4)
    height, width = Counter(sizes).most_common(1)[0][0]
    return Camera(
        width=width,
        height=height,
        frames=footage.still.frames,
        horizon=round(footage.point.row, 3),
        seed_row=min(outline[MIDDLE], default=1.0),
        ego=Ego(outline=outline),
        look=look,
    )


# --- what forbids it --------------------------------------------------------------------


def _check_looks(footage: Footage, gradients: list[Tensor], where: str) -> None:
    """Raise InputError when one half of the frames shows an ego car that the other half lacks."""
    halves = halved(footage, gradients)
    for shown, lacking in (halves, halves[::-1]):
        some, other = ([gradients[at] for at in half] for half in (shown, lacking))
        if _is_foreign(footage.point, some, other):
            problem = (
                f"is of several cameras: {len(lacking)} of {len(gradients)} frames do not show "
            )
            problem += "the ego car of the others, such as number "
            problem += ", ".join(str(at + 1) for at in lacking[:5])
            raise InputError(where, problem, "give the footage of one")


def _is_foreign(point: VanishingPoint, half: list[Tensor], other: list[Tensor]) -> bool:
    """Return whether frames share an ego car that the others lack; both as gradients (2, h, w)."""
    if min(len(half), len(other)) < MIN_FRAMES:
        return False
    still = stillness(half)
    rows = ego_rows(Footage(still, point, road_lines(half, point)))
    if rows is None:
        return False
    # Each is compared with frames that it is not among.
    odd, even = (ego_look(stillness(part), rows) for part in (half[::2], half[1::2]))
    own = torch.cat([likenesses(odd, half[1::2]), likenesses(even, half[::2])])
    strange = likenesses(ego_look(still, rows), other)
    is_sure = float(own.quantile(0.2)) >= OWN_LIKENESS
    return is_sure and float(strange.quantile(0.8)) <= FOREIGN_LIKENESS


def halved(footage: Footage, gradients: Sequence[Tensor]) -> tuple[list[int], list[int]]:
    """Split frames by the lower part of the image, as two cameras would be; return their indices.

    The sign of the first principal component of the normalised gradients, without road lines.
    """
    top = round(MIN_EGO_ROW * gradients[0].shape[1])
    weight = crossing(footage.still.direction, footage.point)
    low = torch.stack([(softened(each) * weight)[:, top:].reshape(-1) for each in gradients])
    centred = low - low.mean(0)
    first = torch.linalg.eigh(centred @ centred.T)[1][:, -1]
    numbers = range(len(gradients))
    return [n for n in numbers if first[n] > 0], [n for n in numbers if first[n] <= 0]
