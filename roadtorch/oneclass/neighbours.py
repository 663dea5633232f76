"""One-class classifiers of the samples as they lie: nearest neighbour, spanning tree (P3).

Distances are taken from differences, coordinate by coordinate: a pixel that equals a sample
has distance 0, and near pixels keep all their digits, both of which |x|² - 2xy + |y|² loses
in single precision. With two or three coordinates it is the faster way as well.
"""

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree
from torch import Tensor

from roadtorch.base.errors import InputError
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
        problem = f"has {len(points)} different samples, more than {most}"
        hint = "take one sample per superpixel, or planes of fewer levels"
        raise InputError(name, problem, hint)
    return points, counts


def fit_nearest(road: Road, _: ClassifierSettings) -> Learned:
    """P3: L = min_j |x - y_j|², here without the square, which changes no rank.

    The toolbox dd_tools divides by the distance from there to the next sample; P3's results stay
    within 3 of the spanning tree's in every combination, which those ratios' do not.
    """
    from scipy.spatial import KDTree  # slow to import, and most others do without

    samples, counts = road.samples.unique(dim=0, return_counts=True)
    points, training = samples.float(), None
    if len(points) > 1:  # leave one out: a sample that occurs twice has its twin as neighbour
        apart = torch.from_numpy(np.asarray(KDTree(samples).query(samples, k=2)[0])[:, 1])
        training = torch.where(counts > 1, 0, apart).repeat_interleave(counts)

    def distance(planes: Tensor) -> Tensor:
        if len(planes) > 1:
            return squared_distances(planes, points).amin(0).sqrt_()
        line, values = points[:, 0].contiguous(), planes[0].contiguous()
        above = torch.searchsorted(line, values).clamp_(max=len(line) - 1)
        below = (above - 1).clamp_(min=0)
        return torch.minimum((line[above] - values).abs_(), (values - line[below]).abs_())

    return Learned(distance, 8 if len(road.axes) == 1 else len(points), training=training)


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


def fit_tree(road: Road, settings: ClassifierSettings) -> Learned:
    """P3: L = |x - p(x)|, p the projection onto the nearest edge, cut off at its ends.

    The edges are those of the minimum spanning tree of the different samples.
    """
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
    offsets = -(starts * directions).sum(1, keepdim=True).float()
    starts, directions, lengths = starts.float(), directions.float(), lengths.float()

    def distance(planes: Tensor) -> Tensor:
        along = torch.addmm(offsets, directions, planes)
        along = torch.minimum(along.clamp_(min=0), lengths, out=along)
        total = torch.zeros_like(along)
        for axis, values in enumerate(planes):
            column = slice(axis, axis + 1)
            rest = (values - starts[:, column]).addcmul_(along, directions[:, column], value=-1)
            total.addcmul_(rest, rest)
        return total.amin(0).sqrt_()

    return Learned(distance, max(len(starts), 4), threshold=threshold)


NN = Classifier("nn", "distance to the nearest sample", ClassifierSettings, fit_nearest)
MST = Classifier(
    "mst", "distance to the samples' minimum spanning tree", ClassifierSettings, fit_tree
)
