"""Propagation of corrections to other superpixels of the image.

The detector's log odds of each superpixel are shifted by a field that is fixed on corrected
superpixels and decays elsewhere: a random walker with priors (Grady, "Multilabel random walker
image segmentation using prior models", CVPR 2005), applied to the shift of the log odds instead of
to probabilities, so that the detector's detail is kept. The graph connects neighbours and similar
superpixels at any distance (ours): one click corrects a whole pavement.
"""

import numpy as np
import torch
from scipy import sparse
from scipy.sparse.linalg import cg
from torch import Tensor

from roadtorch.imaging.segments import Segments

# Chosen by simulated clicks (docs/annotate.md). The first three are the widths of kernels.
COLOR_WIDTH = TEXTURE_WIDTH = 0.08  # Lab colour; gradient and contrast
POSITION_WIDTH = 0.15  # fractions of the image's sides
BORDER_CONTRAST = 0.04  # contrast at a border that lowers a weight to 1/e
SIMILAR = 4  # most similar superpixels that each is connected to
ANCHOR, CONFIDENCE = 0.02, 0.02  # weights of no shift: for every superpixel, and times |log odds|
CORRECTED = 6.0  # log odds of a corrected superpixel

SegmentGraph = sparse.csr_matrix
"""Graph of n superpixels: Laplacian (n, n) of the random walker's weights."""


def segment_graph(segments: Segments) -> SegmentGraph:
    """Build the graph of n segments: edges to neighbours and to the most similar segments."""
    parts = [
        *(segments.color / COLOR_WIDTH),
        segments.gradient / TEXTURE_WIDTH,
        segments.contrast / TEXTURE_WIDTH,
    ]
    features = torch.stack(parts, 1).to(torch.float32).numpy()  # (n, 5), in kernel widths
    count = len(features)
    first, second = segments.pairs.numpy()
    contrast = segments.contrast_between.numpy() / BORDER_CONTRAST
    near = np.exp(-contrast - np.square(features[first] - features[second]).sum(1) / 2)
    rows, columns, weights = [first], [second], [near]
    if count > 1:
        position = torch.stack([segments.row, segments.column], 1).numpy() / POSITION_WIDTH
        points = torch.from_numpy(np.concatenate([features, position], 1))
        distance = torch.cdist(points, points).fill_diagonal_(torch.inf)
        nearest, partner = distance.topk(min(SIMILAR, count - 1), largest=False)
        rows.append(np.repeat(np.arange(count), partner.shape[1]))
        columns.append(partner.reshape(-1).numpy())
        weights.append(np.exp(-nearest.square().reshape(-1).numpy() / 2))
    edges = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    adjacency = sparse.csr_matrix(edges, shape=(count, count))
    return sparse.csr_matrix(sparse.csgraph.laplacian(adjacency.maximum(adjacency.T)))


def propagate(odds: Tensor, evidence: Tensor, graph: SegmentGraph) -> Tensor:
    """Compute the shift of the log odds (n,) of each segment, (n,), from evidence on some.

    evidence: (n,), 1 yes, -1 no, 0 unlabelled. A labelled segment is shifted to at least the log
    odds ``CORRECTED``, with its sign. Elsewhere the shift minimises its squared differences along
    the graph plus its own square, weighted by the detector's confidence.
    """
    fixed = (evidence != 0).numpy()
    shift = np.zeros(len(odds))
    if not fixed.any():
        return torch.zeros_like(odds)
    prior, sign = odds.numpy().astype(np.float64), evidence.numpy()
    target = np.where(sign > 0, np.maximum(prior, CORRECTED), np.minimum(prior, -CORRECTED))
    shift[fixed] = (target - prior)[fixed]
    weight = ANCHOR + CONFIDENCE * np.abs(prior)
    free = ~fixed
    rows = graph[free]
    matrix = rows[:, free] + sparse.diags(weight[free])
    goal = -rows[:, fixed] @ shift[fixed]
    diagonal = sparse.diags(1 / matrix.diagonal())
    shift[free] = cg(matrix, goal, rtol=1e-3, maxiter=200, M=diagonal)[0]
    return torch.from_numpy(shift).to(odds)
