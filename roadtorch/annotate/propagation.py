"""Propagation of corrections to other superpixels of the image.

The detector's log odds of each superpixel are shifted by a field that is fixed on corrected
superpixels and decays elsewhere: a random walker with priors (Grady, "Multilabel random walker
image segmentation using prior models", CVPR 2005), applied to the shift of the log odds instead of
to probabilities, so that the detector's detail is kept. The graph connects neighbours and similar
superpixels at any distance (ours): one click corrects a whole pavement.
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
    """How far a correction propagates; chosen by simulated clicks (docs/annotate.md)."""

    color: float = Field(
        default=0.08, gt=0, le=10, description="kernel width of similarity: Lab colour"
    )
    texture: float = Field(
        default=0.08, gt=0, le=10, description="kernel width of similarity: gradient and contrast"
    )
    position: float = Field(
        default=0.15, gt=0, le=10, description="kernel width of similarity: position, fractions"
    )
    border: float = Field(
        default=0.04, gt=0, le=10, description="contrast at a border that lowers a weight to 1/e"
    )
    similar: int = Field(
        default=4, ge=0, le=100, description="most similar superpixels that each is connected to"
    )
    anchor: float = Field(
        default=0.02, gt=0, le=10, description="weight of no shift, for every superpixel"
    )
    confidence: float = Field(
        default=0.02, ge=0, le=10, description="further weight of no shift, times |log odds|"
    )
    corrected: float = Field(
        default=6.0, gt=0, le=50, description="log odds of a corrected superpixel"
    )


SegmentGraph = sparse.csr_matrix
"""Graph of n superpixels: Laplacian (n, n) of the random walker's weights."""


def segment_graph(segments: Segments, settings: PropagationSettings) -> SegmentGraph:
    """Build the graph of n segments: edges to neighbours and to the most similar segments."""
    parts = [
        *(segments.color / settings.color),
        segments.gradient / settings.texture,
        segments.contrast / settings.texture,
    ]
    features = torch.stack(parts, 1).to(torch.float32).numpy()  # (n, 5), in kernel widths
    count = len(features)
    first, second = segments.pairs.numpy()
    contrast = segments.contrast_between.numpy() / settings.border
    near = np.exp(-contrast - np.square(features[first] - features[second]).sum(1) / 2)
    rows, columns, weights = [first], [second], [near]
    if count > 1 and settings.similar:
        position = torch.stack([segments.row, segments.column], 1).numpy() / settings.position
        points = torch.from_numpy(np.concatenate([features, position], 1))
        distance = torch.cdist(points, points).fill_diagonal_(torch.inf)
        nearest, partner = distance.topk(min(settings.similar, count - 1), largest=False)
        rows.append(np.repeat(np.arange(count), partner.shape[1]))
        columns.append(partner.reshape(-1).numpy())
        weights.append(np.exp(-nearest.square().reshape(-1).numpy() / 2))
    edges = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    adjacency = sparse.csr_matrix(edges, shape=(count, count))
    return sparse.csr_matrix(sparse.csgraph.laplacian(adjacency.maximum(adjacency.T)))


def propagate(
    odds: Tensor, evidence: Tensor, graph: SegmentGraph, settings: PropagationSettings
) -> Tensor:
    """Compute the shift of the log odds (n,) of each segment, (n,), from evidence on some.

    evidence: (n,), 1 yes, -1 no, 0 unlabelled. A labelled segment is shifted to at least the log
    odds ``corrected``, with its sign. Elsewhere the shift minimises its squared differences along
    the graph plus its own square, weighted by the detector's confidence.
    """
    fixed = (evidence != 0).numpy()
    shift = np.zeros(len(odds))
    if not fixed.any():
        return torch.zeros_like(odds)
    prior, sign, corrected = odds.numpy().astype(np.float64), evidence.numpy(), settings.corrected
    target = np.where(sign > 0, np.maximum(prior, corrected), np.minimum(prior, -corrected))
    shift[fixed] = (target - prior)[fixed]
    weight = settings.anchor + settings.confidence * np.abs(prior)
    free = ~fixed
    rows = graph[free]
    matrix = rows[:, free] + sparse.diags(weight[free])
    goal = -rows[:, fixed] @ shift[fixed]
    diagonal = sparse.diags(1 / matrix.diagonal())
    shift[free] = cg(matrix, goal, rtol=1e-3, maxiter=200, M=diagonal)[0]
    return torch.from_numpy(shift).to(odds)
