"""What a correction says about the rest of the image: inference with the corrections held fixed.

The machine's log odds of each superpixel are moved by a field that is fixed where a person spoke
and fades elsewhere: a random walker with priors (Grady, "Multilabel random walker image
segmentation using prior models", CVPR 2005), on the correction of the log odds instead of the
probabilities, so that what the machine knows in detail stays. The walker steps to neighbours and
to superpixels that look alike, wherever they are (ours): one click mends a whole pavement.
"""

import numpy as np
import torch
from pydantic import Field
from scipy import sparse
from scipy.sparse.linalg import cg
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.imaging.segments import Segments


class PropagationSettings(Settings):
    """How far a correction reaches; chosen by simulated clicks (docs/annotate.md)."""

    color: float = Field(default=0.08, gt=0, le=10, description="difference in Lab that parts")
    texture: float = Field(
        default=0.08, gt=0, le=10, description="difference in gradient and contrast that parts"
    )
    place: float = Field(default=0.15, gt=0, le=10, description="distance at which alike fades")
    border: float = Field(default=0.04, gt=0, le=10, description="contrast of a border that parts")
    alike: int = Field(default=4, ge=0, le=100, description="superpixels that look most alike")
    anchor: float = Field(
        default=0.02, gt=0, le=10, description="pull back to the machine's opinion, for each"
    )
    trust: float = Field(
        default=0.02, ge=0, le=10, description="further pull by how sure the machine is"
    )
    sure: float = Field(default=6.0, gt=0, le=50, description="log odds of what a person said")


Graph = sparse.csr_matrix
"""Superpixels (n) as a graph: the Laplacian (n,n) of the walker's weights."""


def segment_graph(segments: Segments, settings: PropagationSettings) -> Graph:
    """The graph of n segments: neighbours by their border and look, and those most alike."""
    parts = [
        *(segments.color / settings.color),
        segments.gradient / settings.texture,
        segments.contrast / settings.texture,
    ]
    look = torch.stack(parts, 1).to(torch.float32).numpy()  # (n,5), in units of what parts them
    count = len(look)
    first, second = segments.pairs.numpy()
    contrast = segments.contrast_between.numpy() / settings.border
    near = np.exp(-contrast - np.square(look[first] - look[second]).sum(1) / 2)
    rows, columns, weights = [first], [second], [near]
    if count > 1 and settings.alike:
        place = torch.stack([segments.row, segments.column], 1).numpy() / settings.place
        points = torch.from_numpy(np.concatenate([look, place], 1))
        distance = torch.cdist(points, points).fill_diagonal_(torch.inf)
        nearest, partner = distance.topk(min(settings.alike, count - 1), largest=False)
        rows.append(np.repeat(np.arange(count), partner.shape[1]))
        columns.append(partner.reshape(-1).numpy())
        weights.append(np.exp(-nearest.square().reshape(-1).numpy() / 2))
    edges = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    adjacent = sparse.csr_matrix(edges, shape=(count, count))
    return sparse.csr_matrix(sparse.csgraph.laplacian(adjacent.maximum(adjacent.T)))


def propagated(odds: Tensor, said: Tensor, graph: Graph, settings: PropagationSettings) -> Tensor:
    """How far the log odds (n,) of each segment move, (n,), for what was said of some.

    said: (n,), 1 yes, -1 no, 0 where nobody spoke. A spoken segment moves until it is as sure as
    ``sure``; one that was surer already stays. The field minimises the squared differences along
    the graph plus its own squares, which weigh more where the machine is sure.
    """
    fixed = (said != 0).numpy()
    moved = np.zeros(len(odds))
    if not fixed.any():
        return torch.zeros_like(odds)
    own, sign = odds.numpy().astype(np.float64), said.numpy()
    target = np.where(sign > 0, np.maximum(own, settings.sure), np.minimum(own, -settings.sure))
    moved[fixed] = (target - own)[fixed]
    pull = settings.anchor + settings.trust * np.abs(own)
    free = ~fixed
    rows = graph[free]
    matrix = rows[:, free] + sparse.diags(pull[free])
    goal = -rows[:, fixed] @ moved[fixed]
    diagonal = sparse.diags(1 / matrix.diagonal())
    moved[free] = cg(matrix, goal, rtol=1e-3, maxiter=200, M=diagonal)[0]
    return torch.from_numpy(moved).to(odds)
