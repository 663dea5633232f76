"""One-class classifiers by distance to the samples: nearest neighbour, spanning tree (P3).

Distances are computed from differences, coordinate by coordinate: a pixel that equals a sample has
distance 0, and near pixels keep all digits, which |x|² - 2xy + |y|² loses in single precision. It
is also faster with two or three coordinates.
"""

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.oneclass.base import Classifier, ClassifierSettings, DistanceModel, RoadSamples

MAX_DISTINCT = 4096  # most distinct samples for a square matrix: 134 MB in double precision


def squared_distances(planes: Tensor, points: Tensor) -> Tensor:
    """Return |x - y|² of pixels, planes (d, n), and points (m, d): (m, n), in the points' type."""
    planes = planes.to(points.dtype)
    total = (planes[0] - points[:, :1]).square_()
    for axis in range(1, len(planes)):
        difference = planes[axis] - points[:, axis : axis + 1]
        total.addcmul_(difference, difference)
    return total


def distinct_samples(name: str, samples: Tensor, most: int = MAX_DISTINCT) -> tuple[Tensor, Tensor]:
    """Return the distinct rows of samples (m, d), sorted, and their counts (k,).

    Raises InputError where a square matrix of them would be too large.
    """
    points, counts = samples.unique(dim=0, return_counts=True)
    if len(points) > most:
        problem = f"has {len(points)} distinct samples, more than {most}"
        hint = "take one sample per superpixel, or planes with fewer levels"
        raise InputError(name, problem, hint)
    return points, counts


def fit_nearest(road: RoadSamples, _: ClassifierSettings) -> DistanceModel:
    """Fit P3's L = min_j |x - y_j|², here without the square, which changes no rank.

    The toolbox dd_tools divides by the distance from there to the next sample; P3's results are
    within 3 of the spanning tree's in every combination, those ratios are not.
    """
    from scipy.spatial import KDTree  # slow to import

    samples, counts = road.samples.unique(dim=0, return_counts=True)
    points, training = samples.float(), None
    if len(points) > 1:  # leave-one-out: a duplicate has its twin as neighbour
        nearest = torch.from_numpy(np.asarray(KDTree(samples).query(samples, k=2)[0])[:, 1])
        training = torch.where(counts > 1, 0, nearest).repeat_interleave(counts)

    def distance(planes: Tensor) -> Tensor:
        if len(planes) > 1:
            return squared_distances(planes, points).amin(0).sqrt_()
        line, values = points[:, 0].contiguous(), planes[0].contiguous()
        above = torch.searchsorted(line, values).clamp_(max=len(line) - 1)
        below = (above - 1).clamp_(min=0)
        return torch.minimum((line[above] - values).abs_(), (values - line[below]).abs_())

    return DistanceModel(distance, 8 if len(road.axes) == 1 else len(points), training=training)


def spanning_tree(points: Tensor) -> Tensor:
    """Return the edges of the minimum spanning tree of distinct points (m, d): int64 (m-1, 2).

    Where several trees are minimal, the order of the points decides.
    """
    from scipy.spatial.distance import cdist  # slow to import

    if len(points) == 1:
        return torch.zeros((0, 2), dtype=torch.int64)
    if points.shape[1] == 1:
        order = points[:, 0].argsort()
        return torch.stack((order[:-1], order[1:]), dim=1)
    # In a dense matrix, SciPy treats distances below 1e-8 as no edge.
    tree = minimum_spanning_tree(csr_array(cdist(points, points))).tocoo()
    return torch.from_numpy(np.stack((tree.row, tree.col), axis=1)).long()


def edge_quantile(lengths: Tensor, fraction: float) -> float:
    """Return the toolbox's threshold: the edge length that ``fraction`` of the m-1 lengths reach.

    The r-th of the sorted lengths with r = ⌊(m-1)·fraction + 1/2⌋; 0 where r = 0.
    """
    rank = int(len(lengths) * fraction + 0.5)
    return float(lengths.sort().values[rank - 1]) if rank else 0.0


def fit_tree(road: RoadSamples, settings: ClassifierSettings) -> DistanceModel:
    """Fit P3's L = |x - p(x)|, p the projection onto the nearest edge, clipped to its ends.

    The edges are those of the minimum spanning tree of the distinct samples.
    """
    points, _ = distinct_samples("mst", road.samples)
    edges = spanning_tree(points)
    starts, ends = points[edges[:, 0]], points[edges[:, 1]]
    # The samples lie on the tree: their distances are 0 and set no threshold.
    threshold = edge_quantile((ends - starts).norm(dim=1), 1 - settings.rejected)
    if len(points) == 1 or len(road.axes) == 1:  # a point, or the line between the ends
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
            residual = (values - starts[:, column]).addcmul_(along, directions[:, column], value=-1)
            total.addcmul_(residual, residual)
        return total.amin(0).sqrt_()

    return DistanceModel(distance, max(len(starts), 4), threshold=threshold)


NN = Classifier("nn", "distance to the nearest sample", ClassifierSettings, fit_nearest)
MST = Classifier(
    "mst", "distance to the samples' minimum spanning tree", ClassifierSettings, fit_tree
)
