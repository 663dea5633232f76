"""Estimation of a camera from some dozens of its frames."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.errors import InputError
from roadtorch.camera.camera import (
    MAX_ASPECT_CHANGE,
    MAX_SIMILARITY,
    MIN_SIMILARITY,
    Camera,
    EgoTemplate,
    build_ego_template,
    template_similarities,
    to_floats,
)
from roadtorch.camera.gradients import (
    GradientStatistics,
    VanishingPoint,
    gradient_statistics,
    line_deviation,
    road_lines,
    small_grey,
    small_size,
    sobel_gradient,
    soft_normalize,
    vanishing_point,
)
from roadtorch.camera.ground import Lens, project_rays
from roadtorch.camera.views import SLOPE_AHEAD, sample_view, view_ahead
from roadtorch.imaging.resize import WorkingSize, resize_to_work, spatial_size
from roadtorch.road.ego import Ego
from roadtorch.road.illuminant import invariant_angle, log_chromaticity, projection_entropies

# --- the ego car below a static edge --------------------------------------------------

NEUTRAL_EVIDENCE = 0.35  # evidence of an edge at which a column neither gains nor loses
MIN_EVIDENCE = 0.08  # mean evidence above NEUTRAL_EVIDENCE from which there is an ego car
MAX_CLIMB, CLIMB_COST = 3, 0.15  # rows by which a path may climb per column, and cost of each
NEXT_EDGE_RATIO = 0.6  # evidence of the ego car's next edge above, relative to the best path
MAX_EDGE_DISTANCE = 0.15  # from the best path to an edge above, fraction of the height
MIN_EDGE_GAP = 3  # rows between two edges; closer ones are one blurred edge
MIN_EGO_ROW = 0.6  # fraction of the height above which no ego car begins
MIN_BELOW_HORIZON = 0.12  # from the vanishing point to an ego car, fraction of the height
ENTROPY_STEP = 4  # frames to one whose entropies are computed
MIN_EGO_HEIGHT = 0.02  # fraction of the height; a lower strip is the image's border, or noise

# Fraction of slanting edges that aim at the vanishing point, from which a region is road: about
# .1 to .3 on bonnets, .4 to .9 on roads with lanes; chance is .16.
MAX_ROAD_LINE_FRACTION = 0.45


class FootageStatistics(NamedTuple):
    """Statistics of frames of one camera, at the reduced size (h, w)."""

    gradients: GradientStatistics
    point: VanishingPoint
    lines: Tensor  # (2, h, w), strength of edges that aim at the vanishing point, and of all


def _footage_statistics(gradients: Sequence[Tensor]) -> FootageStatistics:
    """Return the statistics of the gradients (2, h, w) of two or more frames."""
    point = vanishing_point(gradients)
    return FootageStatistics(gradient_statistics(gradients), point, road_lines(gradients, point))


def _find_ego_rows(footage: FootageStatistics) -> Tensor | None:
    """Return the row (w,) int64 where the ego car begins in each column (h: none), or None.

    The best path of a static edge that has no road below; then the next nearly as good one close
    above, as long as there is one: a bonnet has several edges, and wipers before it.
    """
    evidence = _edge_evidence(footage.gradients, footage.point)
    height, row = len(evidence), torch.arange(len(evidence))[:, None]
    rows, gain = _best_path(evidence)
    while gain >= MIN_EVIDENCE and _is_road(footage.lines, row >= rows + MIN_EDGE_GAP):
        # A reflection in the windscreen, or texture of the road: search further down.
        rows, gain = _best_path(evidence * (row > rows + MIN_EDGE_GAP))
    if gain < MIN_EVIDENCE:
        return None
    while (above := _find_edge_above(footage.lines, evidence, rows, gain)) is not None:
        rows = above
    return rows if height - int(rows.min()) >= MIN_EGO_HEIGHT * height else None


def _find_edge_above(lines: Tensor, evidence: Tensor, rows: Tensor, gain: float) -> Tensor | None:
    """Return the rows (w,) of an edge close above that belongs to the ego car; None without one."""
    height, row = len(evidence), torch.arange(len(evidence))[:, None]
    close = (row < rows - MIN_EDGE_GAP) & (row >= rows - MAX_EDGE_DISTANCE * height)
    above, gain_above = _best_path(evidence * close)
    higher = torch.minimum(rows, above)
    between = (row >= higher + MIN_EDGE_GAP) & (row < rows - MIN_EDGE_GAP)
    is_edge = gain_above >= max(MIN_EVIDENCE, NEXT_EDGE_RATIO * gain)
    return higher if is_edge and not _is_road(lines, between) else None


def _is_road(lines: Tensor, region: Tensor) -> bool:
    """Return whether the edges in a region bool (h, w) aim at the vanishing point."""
    aiming, total = (float(strength[region].sum()) for strength in lines)
    return aiming > MAX_ROAD_LINE_FRACTION * total


def _edge_evidence(gradients: GradientStatistics, point: VanishingPoint) -> Tensor:
    """Return the evidence of static edges that are no lines of the road: (h, w) in [0, 1]."""
    direction = gradients.direction
    evidence = gradients.coherence * line_deviation(direction, point) * direction[1].abs()
    evidence[: round(max(MIN_EGO_ROW, point.row + MIN_BELOW_HORIZON) * len(evidence))] = 0
    return F.max_pool2d(evidence[None, None], (3, 1), 1, (1, 0))[0, 0]


def _best_path(evidence: Tensor) -> tuple[Tensor, float]:
    """Return the path across evidence (h, w) of the largest gain: row (w,) int64, and the gain.

    Row h, below the image, is free; the gain is the evidence above NEUTRAL_EVIDENCE, averaged over
    the columns. Dynamic programming over the columns.
    """
    height, width = evidence.shape
    gain = torch.cat([evidence - NEUTRAL_EVIDENCE, evidence.new_zeros(1, width)])
    steps = torch.arange(-MAX_CLIMB, MAX_CLIMB + 1)
    cost = CLIMB_COST * steps.abs()[:, None]
    total, previous = gain[:, 0], []
    for column in range(1, width):
        padded = F.pad(total, (MAX_CLIMB, MAX_CLIMB), value=-torch.inf)
        best = (padded.unfold(0, height + 1, 1) - cost).max(0)
        total = best.values + gain[:, column]
        previous.append(torch.arange(height + 1) + steps[best.indices])
    row = int(total.argmax())
    rows = [row]
    for previous_row in reversed(previous):
        rows.append(row := int(previous_row[row]))
    return torch.tensor(rows[::-1]), float(total.max()) / width


# --- the camera ------------------------------------------------------------------------

MIN_CAMERA_FRAMES = 5  # frames; fewer have edges in common by chance
OUTLINE_COLUMNS = 64  # columns of the outline in a camera's file
MAX_STATIC_FRACTION = 0.85  # above, nothing moves; straight motorways reach .7

# Similarity to the ego car of some frames that four of five other frames of the camera reach, and
# that four of five frames of another camera do not exceed.
MIN_OWN_SIMILARITY, MAX_FOREIGN_SIMILARITY = 0.8, 0.35

# Columns of the outline over which the seed row is computed: those of the seed area.
MIDDLE_COLUMNS = slice(OUTLINE_COLUMNS * 3 // 8, OUTLINE_COLUMNS * 5 // 8)


class StaticFootageError(InputError):
    """Footage in which nothing moves."""


def estimate_camera(
    frames: Iterable[Tensor], where: str = "footage", lens: Lens | None = None
) -> Camera:
    """Estimate the camera from frames that it recorded.

    Args:
        frames: sRGB in [0, 1], shape (3, H, W) each, 5 to some hundred; iterated over once.
        where: names the footage in errors.
        lens: becomes part of the camera, of fewer than 5 frames all of it; the horizon is
            estimated where it has no distortion.

    Raises:
        StaticFootageError: for footage in which nothing moves.
        InputError: for too few frames, and for several cameras (of different shapes, or with an ego
            car in one part of the frames only).
    """
    sizes, greys, entropies, rectified = [], [], [], []
    for frame in frames:
        sizes.append(spatial_size(frame))
        greys.append(small_grey(frame, small_size([frame])))
        if lens is not None:
            view = sample_view(frame, lens, view_ahead(lens))
            rectified.append(sobel_gradient(small_grey(view, small_size([view]))))
        if len(entropies) * ENTROPY_STEP < len(sizes):
            small = resize_to_work(frame, WorkingSize())  # finer levels, as in the detector
            entropies.append(projection_entropies(log_chromaticity(small)))
    if len(sizes) < MIN_CAMERA_FRAMES and lens is not None and sizes:
        height, width = sizes[0]
        lens = lens.at(width, height)
        return Camera(width=width, height=height, frames=len(sizes), seed_row=1.0, lens=lens)
    if len(sizes) < MIN_CAMERA_FRAMES:
        number = "one frame" if len(sizes) == 1 else f"{len(sizes)} frames"
        raise InputError(where, f"has {number}", "give 10 or more, of different places")
    shapes = sorted(set(sizes), key=lambda size: size[1] / size[0])
    (low_height, low_width), (height, width) = shapes[0], shapes[-1]
    if width / height > MAX_ASPECT_CHANGE * low_width / low_height:
        problem = f"is of several cameras: {low_width}×{low_height} and {width}×{height} pixels"
        raise InputError(where, problem, "give the footage of one")
    size = small_size(greys)
    resized = (F.interpolate(grey[None, None], size, mode="bilinear")[0, 0] for grey in greys)
    gradients = [sobel_gradient(grey) for grey in resized]
    footage = _footage_statistics(gradients)
    if footage.gradients.static_fraction >= MAX_STATIC_FRACTION:
        raise StaticFootageError(where, "is static: nothing moves", "give footage of a drive")
    _require_one_camera(footage, gradients, where)
    rows = _find_ego_rows(footage)
    template, outline = EgoTemplate(), ()
    if rows is not None:
        template = build_ego_template(footage.gradients, rows)
        # Three fifths of what four of five frames exceed, as future frames differ more than these.
        similarity = float(template_similarities(template, gradients).quantile(0.2))
        threshold = min(MAX_SIMILARITY, max(MIN_SIMILARITY, 0.6 * similarity))
        template = template.model_copy(update={"min_similarity": round(threshold, 3)})
        heights = F.adaptive_avg_pool1d(rows[None].to(torch.float64) / size[0], OUTLINE_COLUMNS)[0]
        outline = to_floats(heights, 4)
    height, width = Counter(sizes).most_common(1)[0][0]
    horizon = footage.point.row
    if lens is not None:
        lens = lens.at(width, height)
        slope = (2 * vanishing_point(rectified).row - 1) * SLOPE_AHEAD
        pixels, _ = project_rays(lens, np.array([[0.0, slope, 1.0]]))
        horizon = min(1.0, max(0.0, (float(pixels[0, 1]) + 0.5) / height))
    return Camera(
        width=width,
        height=height,
        frames=footage.gradients.frames,
        horizon=round(horizon, 3),
        seed_row=min(outline[MIDDLE_COLUMNS], default=1.0),
        invariant_angle=invariant_angle(torch.stack(entropies).mean(0)),
        lens=lens,
        ego=Ego(outline=outline),
        template=template,
    )


# --- several cameras --------------------------------------------------------------------


def _require_one_camera(footage: FootageStatistics, gradients: list[Tensor], where: str) -> None:
    """Raise InputError when one half of the frames shows an ego car that the other half lacks."""
    parts = _split_by_appearance(footage, gradients)
    for halves in (parts, parts[::-1]):
        first, second = ([gradients[at] for at in half] for half in halves)
        if _lacks_ego_car(footage.point, first, second):
            numbers = ", ".join(str(at + 1) for at in halves[1][:5])
            problem = f"is of several cameras: {len(second)} of {len(gradients)} frames do not "
            problem += f"show the ego car of the others, such as number {numbers}"
            raise InputError(where, problem, "give the footage of one")


def _lacks_ego_car(point: VanishingPoint, first: list[Tensor], second: list[Tensor]) -> bool:
    """Return whether the first frames share an ego car that the second lack, by gradients."""
    if min(len(first), len(second)) < MIN_CAMERA_FRAMES:
        return False
    statistics = gradient_statistics(first)
    rows = _find_ego_rows(FootageStatistics(statistics, point, road_lines(first, point)))
    if rows is None:
        return False
    # Cross-validated: each template is compared with frames that it was not built from.
    halves = first[::2], first[1::2]
    templates = [build_ego_template(gradient_statistics(half), rows) for half in halves]
    in_first = torch.cat([*map(template_similarities, templates, halves[::-1])])
    in_second = template_similarities(build_ego_template(statistics, rows), second)
    is_certain = float(in_first.quantile(0.2)) >= MIN_OWN_SIMILARITY
    return is_certain and float(in_second.quantile(0.8)) <= MAX_FOREIGN_SIMILARITY


def _split_by_appearance(
    footage: FootageStatistics, gradients: Sequence[Tensor]
) -> tuple[list[int], list[int]]:
    """Split frames by the lower part of the image, as two cameras would be; return their indices.

    The sign of the first principal component of the normalised gradients, without road lines.
    """
    top = round(MIN_EGO_ROW * gradients[0].shape[1])
    weight = line_deviation(footage.gradients.direction, footage.point)
    units = map(soft_normalize, gradients)
    vectors = torch.stack([(unit * weight)[:, top:].reshape(-1) for unit in units])
    centred = vectors - vectors.mean(0)
    first = torch.linalg.eigh(centred @ centred.T)[1][:, -1]
    numbers = range(len(gradients))
    return [n for n in numbers if first[n] > 0], [n for n in numbers if first[n] <= 0]
