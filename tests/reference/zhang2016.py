"""P1's text from image to mask, slow and simple, in NumPy's double precision.

Choices that the text leaves open are the program's, as docs/how/features.md lists: the blur's
windows, the constants of contrast and whitening, empty clusters, the dilation.
"""

from collections.abc import Iterator

import numpy as np

from tests.reference import ufl

Array = np.ndarray
GREY = np.array([0.298936021, 0.587043074, 0.114020904])
LEVELS, LEAST, LAMBDA, SELECTED, ROUNDS = 16, 50, 2.0, 40, 10


def features(image: Array, bases: Array) -> Array:
    """Return the 40 best maps (40, H-5, W-5) of an image (3, H, W), from bases (200, 108)."""
    smooth = np.stack([ufl.blurred(channel, 1.5, 3) for channel in image])  # eq. 1
    even = smooth / ufl.blurred(np.tensordot(GREY, smooth, 1), 0.5, 2)  # eq. 2
    patches = ufl.patches(even, 6)
    patches = patches - patches.mean(1, keepdims=True)
    patches /= np.sqrt(patches.var(1, ddof=1, keepdims=True) + 10 / 255**2)
    values, vectors = np.linalg.eigh(np.cov(patches.T))
    white = (patches - patches.mean(0)) @ vectors @ np.diag((values + 0.1) ** -0.5) @ vectors.T
    for _ in range(ROUNDS):
        nearest = distances(white, bases).argmin(0)
        members = [white[nearest == number] for number in range(len(bases))]
        bases = np.array([group.mean(0) if len(group) else np.zeros(108) for group in members])
    far = distances(white, bases)
    maps = np.maximum(0, far.mean(1, keepdims=True) - far)  # eq. 4
    maps /= np.where(maps.max(1, keepdims=True) > 0, maps.max(1, keepdims=True), 1)
    maps = maps.reshape(-1, image.shape[1] - 5, image.shape[2] - 5)
    scores = [ufl.score(unit_map) for unit_map in maps]  # eq. 5
    return maps[np.argsort(scores)[::-1][:SELECTED]]


def distances(points: Array, bases: Array) -> Array:
    """Return |x - D| for every base and point: (k, n)."""
    return np.array([np.sqrt(((points - base) ** 2).sum(1)) for base in bases])


def place(rows: int, columns: int) -> Array:
    """Return the first two terms of eq. 6, rows and columns counted from 1."""
    row, column = np.mgrid[1 : rows + 1, 1 : columns + 1]
    half = rows / 2
    return (row - half) / half + (half - np.abs(column - columns / 2)) / half


def nodes_of(node: ufl.Node) -> Iterator[ufl.Node]:
    """Yield every node inside, parents first."""
    for child in node.children:
        yield child
        yield from nodes_of(child)


def errors(maps: Array, road: Array) -> Array:
    """Return eq. 10 as stated, P of the covariance of the road's features; scaled to [0, 1]."""
    values, vectors = np.linalg.eigh(np.cov(maps[:, road]))
    shares = np.cumsum(values[::-1]) / values.sum()
    basis = vectors[:, ::-1][:, : int(np.sum(shares < 0.95)) + 1]
    features = maps.reshape(len(maps), -1)
    error = np.linalg.norm(features - basis @ (basis.T @ features), axis=0).reshape(road.shape)
    return (error - error.min()) / (error.max() - error.min())


def road(image: Array, bases: Array) -> Array:
    """Return the mask of an image (3, H, W), bool (H, W)."""
    maps = features(image, bases)
    mean = maps.mean(0)
    tree = ufl.tree(mean, [level / LEVELS for level in range(LEVELS)], LEAST)
    where = pixels = place(*mean.shape)
    for iteration in range(2):
        best = [(ufl.optimise(node, pixels)[0], node) for node in nodes_of(tree)]
        if iteration == 1 or not best:
            break
        area = np.zeros(mean.shape, bool)  # the listing: the node of greatest best sum
        for pixel in max(best, key=lambda pair: pair[0])[1].regions[0]:
            area[pixel] = True
        pixels = where - LAMBDA * errors(maps, area)  # eq. 6
    chosen = [node for child in tree.children for node in ufl.optimise(child, pixels)[1]]  # eq. 9
    mask = np.zeros(mean.shape, bool)
    for pixel in (pixel for node in chosen for pixel in node.regions[0]):
        mask[max(pixel[0] - 3, 0) : pixel[0] + 4, max(pixel[1] - 3, 0) : pixel[1] + 4] = True
    return ufl.to_image(mask)
