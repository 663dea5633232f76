"""Where things are in a road picture: the seed area, location priors, squares, regions."""

import cv2
import numpy as np
import torch
from pydantic import Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from roadtorch.errors import ConfigError
from roadtorch.settings import Settings

FRAME = (240, 320)
"""Height and width in pixels of the frame in which a seed area is described."""

APEX = 0.45
"""Where the triangle of ``prior_triangle`` begins, in heights from the top: a usual horizon."""

BASE = 1.16
"""Width of its base on the bottom edge, in widths: the road leaves the picture at the sides."""


class SeedArea(Settings):
    """The rectangle at the middle of the bottom edge that is taken to be road."""

    height: float = Field(
        default=30, ge=1, le=FRAME[0], description="rows, of a frame of 240; scaled with the image"
    )
    width: float = Field(
        default=80, ge=1, le=FRAME[1], description="columns, of a frame of 320; scaled likewise"
    )


def seed_area(
    height: int, width: int, seed: SeedArea | None = None, least: int = 1
) -> tuple[slice, slice]:
    """Rows and columns of the seed area in a picture of height × width pixels.

    At the middle of the bottom edge, of at least ``least`` pixels on each side where the
    picture has them, and always inside. P2 (section 4, "the central-bottom part of the
    image"); without ``seed`` the default size.
    """
    seed = SeedArea() if seed is None else seed
    rows = min(height, max(least, round(seed.height * height / FRAME[0])))
    columns = min(width, max(least, round(seed.width * width / FRAME[1])))
    left = (width - columns) // 2
    return slice(height - rows, height), slice(left, left + columns)


def prior_uniform(height: int, width: int) -> Tensor:
    """0.5 everywhere, float32 (H,W): every pixel may be road (the uniform prior of P2)."""
    return torch.full((height, width), 0.5)


def prior_rows(height: int, width: int) -> Tensor:
    """Row / height, float32 (H,W), pixel centres: the lower, the more likely road."""
    rows = (torch.arange(height, dtype=torch.float32) + 0.5) / height
    return rows[:, None].expand(height, width).contiguous()


def prior_triangle(height: int, width: int) -> Tensor:
    """1 in a triangle with its base on the bottom edge, 0 elsewhere: float32 (H,W).

    A straight road ahead, ours: apex in the middle at ``APEX``, base ``BASE``. MaxF on the
    development drives 0001TP, 0006R0 and 0016E5 of CamVid: 0.750, 0.842, 0.863; IDD: 0.811.
    """
    rows = (torch.arange(height, dtype=torch.float32)[:, None] + 0.5) / height
    columns = (torch.arange(width, dtype=torch.float32) + 0.5) / width
    reach = BASE / 2 * (rows - APEX) / (1 - APEX)
    return ((columns - 0.5).abs() <= reach).to(torch.float32)


def squares(height: int, width: int, size: int) -> Tensor:
    """Cut a picture into squares of ``size`` pixels: int64 labels (H,W), 0…n-1 by rows.

    The squares at the right and the bottom edge are cut off there. P2, section 4 ("fixed
    square regions"). Raises ConfigError for a size below 1.
    """
    if size < 1:
        raise ConfigError("size", f"{size} was given", "give squares of 1 pixel or more")
    across = -(-width // size)
    rows = torch.arange(height) // size
    return rows[:, None] * across + torch.arange(width) // size


def remove_isolated(mask: Tensor, rows: slice, columns: slice) -> Tensor:
    """Keep the 4-connected regions of a mask (H,W) that touch the rectangle rows × columns.

    Where none does, the mask comes back unchanged: then it says nothing about which
    region is the road. P2, section 6.2 (isolated areas are discarded).
    """
    pixels = np.ascontiguousarray(mask.cpu().numpy(), dtype=np.uint8)
    count, found = cv2.connectedComponents(pixels, connectivity=4)
    regions = np.asarray(found, dtype=np.int32)
    kept = np.zeros(count, dtype=bool)
    kept[regions[rows, columns]] = True
    kept[0] = False  # the background
    if not kept.any():
        return mask
    return torch.from_numpy(kept.take(regions)).to(mask.device)


def seed_segments(labels: Tensor, seed: SeedArea | None = None) -> Tensor:
    """Numbers of the segments of labels (H,W) that lie in the seed area: int64 (k,), k ≥ 1.

    Those that have half of their pixels in it, and always the one that fills most of it.
    """
    rows, columns = seed_area(labels.shape[0], labels.shape[1], seed)
    count = int(labels.max()) + 1
    inside = torch.bincount(labels[rows, columns].reshape(-1), minlength=count)
    size = torch.bincount(labels.reshape(-1), minlength=count)
    return ((2 * inside >= size.clamp_min(1)) | (inside == inside.max())).nonzero()[:, 0]


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
