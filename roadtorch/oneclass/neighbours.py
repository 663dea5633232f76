"""One-class classifiers of the samples as they lie: nearest neighbour, spanning tree (P3).

Distances are taken from differences, coordinate by coordinate: a pixel that equals a sample
has distance 0, and near pixels keep all their digits, both of which |x|² - 2xy + |y|² loses
in single precision. With two or three coordinates it is the faster way as well.
"""

from functools import partial
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.oneclass.base import Classifier, ClassifierSettings, Learned, Road

MAX_DISTINCT = 4096
"""Distinct samples of which a square matrix is made: 134 MB in double precision."""


def squared_distances(planes: Tensor, points: Tensor) -> Tensor:
    """|x - y|² between pixels x, planes (d,n), and points y (m,d): (m,n), in the points' type."""
    planes = planes.to(points.dtype)
    total = (planes[0] - points[:, :1]).square_()
    for axis in range(1, len(planes)):
        difference = planes[axis] - points[:, axis : axis + 1]
        total.addcmul_(difference, difference)
    return total


def few_distinct(name: str, samples: Tensor, most: int = MAX_DISTINCT) -> tuple[Tensor, Tensor]:
    """The different rows of samples (m,d), sorted, and how often each occurs (k,).

    InputError where a square matrix of them would be too large.
    """
    points, counts = samples.unique(dim=0, return_counts=True)
    if len(points) > most:
        what = f"has {len(points)} different samples, more than {most}"
        remedy = "take one sample per superpixel, or planes of fewer levels"
        raise InputError(name, what, remedy)
    return points, counts


# --- nearest neighbour ------------------------------------------------------------------


class NearestSettings(ClassifierSettings):
    """Nearest neighbour."""

    reading: Literal["distance", "ratio"] = Field(
        default="distance",
        description="distance to the nearest sample (the paper), or that over the distance from "
        "there to the next sample (the toolbox dd_tools)",
    )


def nearest_on_line(points: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """|x - y| to the nearest of points y (m,), sorted, and which it is; values x (n,)."""
    above = torch.searchsorted(points, values).clamp_(max=len(points) - 1)
    below = (above - 1).clamp_(min=0)
    up, down = (points[above] - values).abs_(), (values - points[below]).abs_()
    return torch.minimum(up, down), torch.where(up < down, above, below)


def fit_nearest(road: Road, settings: NearestSettings) -> Learned:
    """The different samples, and how far each is from the next."""
    from scipy.spatial import KDTree  # slow to import, and most others do without

    points, counts = road.samples.unique(dim=0, return_counts=True)
    floats = 8 if len(road.axes) == 1 else len(points)
    distance = partial(nearest_distance, points=points.float())
    if len(points) == 1:
        return Learned(distance, floats)
    both = KDTree(points).query(points, k=2)
    own, nearest = (torch.from_numpy(np.asarray(values)[:, 1]) for values in both)
    if settings.reading == "ratio":
        distance = partial(distance, own=own.float().contiguous())
        training = own / own[nearest]
    else:  # leave one out: a sample that occurs twice has its twin as neighbour
        training = torch.where(counts > 1, 0, own)
    return Learned(distance, floats, training=training.repeat_interleave(counts))


def nearest_distance(planes: Tensor, points: Tensor, own: Tensor | None = None) -> Tensor:
    """P3: L = min_j |x - y_j|², here without the square, which changes no rank.

    points: (m,d), sorted where d = 1; with ``own`` (m,), the distance of each point to
    its next one, the toolbox's reading |x - y*| / own(y*) with y* the nearest point. P3's
    formula is the distance, and its results stay within 3 of the spanning tree's in every
    combination, which the ratio's do not; so the distance is the default. Planes (d,n) to (n,).
    """
    if len(planes) == 1:
        distances, nearest = nearest_on_line(points[:, 0].contiguous(), planes[0].contiguous())
        return distances if own is None else distances / own[nearest]
    if own is None:
        return squared_distances(planes, points).amin(0).sqrt_()
    # Along the last axis the least value with its place is found three times faster.
    least, nearest = squared_distances(planes, points).T.contiguous().min(1)
    return least.sqrt_() / own[nearest]


# --- minimum spanning tree --------------------------------------------------------------


class SpanningTreeSettings(ClassifierSettings):
    """Minimum spanning tree."""


def spanning_tree(points: Tensor) -> Tensor:
    """The edges of the minimum spanning tree of different points (m,d): int64 (m-1,2).

    Where several trees are minimal, the order of the points decides.
    """
    from scipy.spatial.distance import cdist  # slow to import, and most others do without

    if len(points) == 1:
        return torch.zeros((0, 2), dtype=torch.int64)
    if points.shape[1] == 1:
        order = points[:, 0].argsort()
        return torch.stack((order[:-1], order[1:]), dim=1)
    # Of a dense matrix SciPy takes distances below 1e-8 for no edge at all.
    tree = minimum_spanning_tree(csr_array(cdist(points, points))).tocoo()
    return torch.from_numpy(np.stack((tree.row, tree.col), axis=1)).long()


def edge_quantile(lengths: Tensor, fraction: float) -> float:
    """The toolbox's threshold: the edge length that ``fraction`` of the m-1 lengths reach.

    The r-th of the sorted lengths with r = ⌊(m-1)·fraction + 1/2⌋; 0 where r = 0.
    """
    rank = int(len(lengths) * fraction + 0.5)
    return float(lengths.sort().values[rank - 1]) if rank else 0.0


def fit_tree(road: Road, settings: SpanningTreeSettings) -> Learned:
    """The minimum spanning tree of the different samples."""
    points, _ = few_distinct("mst", road.samples)
    edges = spanning_tree(points)
    starts, ends = points[edges[:, 0]], points[edges[:, 1]]
    # The samples lie on the tree: their own distances are 0 and set no threshold.
    threshold = edge_quantile((ends - starts).norm(dim=1), 1 - settings.rejected)
    if len(points) == 1 or len(road.axes) == 1:  # a point, or all of the line between the ends
        starts, ends = points[:1], points[-1:]
    steps = ends - starts
    lengths = steps.norm(dim=1, keepdim=True)
    directions = steps / torch.where(lengths > 0, lengths, 1)
    distance = partial(
        tree_distance,
        starts=starts.float(),
        directions=directions.float(),
        lengths=lengths.float(),
        offsets=-(starts * directions).sum(1, keepdim=True).float(),
    )
    return Learned(distance, max(len(starts), 4), threshold=threshold)


def tree_distance(
    planes: Tensor, starts: Tensor, directions: Tensor, lengths: Tensor, offsets: Tensor
) -> Tensor:
    """P3: L = |x - p(x)| with p the projection onto the nearest edge, cut off at its ends.

    starts, directions: (m,d); lengths, offsets (minus the start along the edge): (m,1).
    Planes (d,n) to (n,).
    """
    along = torch.addmm(offsets, directions, planes)
    along = torch.minimum(along.clamp_(min=0), lengths, out=along)
    total = torch.zeros_like(along)
    for axis, values in enumerate(planes):
        column = slice(axis, axis + 1)
        rest = (values - starts[:, column]).addcmul_(along, directions[:, column], value=-1)
        total.addcmul_(rest, rest)
    return total.amin(0).sqrt_()


NN = Classifier("nn", "distance to the nearest sample", NearestSettings, fit_nearest)
MST = Classifier(
    "mst", "distance to the samples' minimum spanning tree", SpanningTreeSettings, fit_tree
)
