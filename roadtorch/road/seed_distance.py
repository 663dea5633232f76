"""How far a segment is from the seed area, along the picture.

Ours, after the geodesic distances of interactive segmentation: a kerb or a painted line must
be crossed somewhere even where both sides have the same colour.
"""

import numpy as np
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from roadtorch.imaging.order_statistics import lower_quartile
from roadtorch.superpixels.features import Segments

FAINTEST = 0.0034
"""Added to the contrast of a faint border (Lab/100): in a clean picture less is no edge either."""


def seed_distance(segments: Segments, sources: Tensor) -> Tensor:
    """Distance (n,) of each segment from the sources, numbers (k,) of segments, along the picture.

    The least sum of the contrasts of the borders crossed on the way: a kerb or a painted line
    must be crossed somewhere even where both sides have the same colour. The unit is a faint
    border of this picture (the lower quartile), so that grain does not count. Ours, after
    the geodesic distances of interactive segmentation.
    """
    steps = segments.contrast_between
    if len(steps):
        steps = steps / (lower_quartile(steps) + FAINTEST)
    return distances(segments.pairs, steps, sources, len(segments.size))


def distance_likelihood(distance: Tensor, reach: float) -> Tensor:
    """Likelihood of road at a distance ≥ 0 from the seed area: 0.73 there, 0.5 at ``reach``."""
    return (1 - distance / reach).sigmoid()


def distances(pairs: Tensor, steps: Tensor, sources: Tensor, count: int) -> Tensor:
    """Least sum of steps on a way from any source to each of ``count`` nodes: (count,).

    pairs: int64 (2,E), each edge once; steps: (E,), ≥ 0. Dijkstra's algorithm; nodes out of
    reach are infinitely far.
    """
    one, two = pairs.cpu().numpy()
    # SciPy takes a stored 0 for a missing edge.
    cost = steps.cpu().numpy().astype(np.float64) + np.finfo(np.float32).tiny
    graph = coo_array((cost, (one, two)), shape=(count, count)).tocsr()
    least = dijkstra(graph, directed=False, indices=sources.cpu().numpy(), min_only=True)
    return torch.from_numpy(least).to(steps)
