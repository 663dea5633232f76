"""The pictures of P1's figures, at the size at which P1 works and scores."""

from collections.abc import Iterator
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Truth, every_kth
from roadtorch.detectors.ufl import OriginalUflSettings, road_cues
from roadtorch.io.image import to_pixels
from roadtorch.settings import build_settings
from roadtorch.ufl.learned import LearnedFeatures, learn_features
from roadtorch.ufl.preprocess import WorkingShape, bicubic

SETS = {"camvid": ("camvid", 18), "idd-lite": ("idd_lite", 10), "kitti-road": ("kitti_road", 5)}
"""By name of the set: its folder in the data, and how many of its pictures are taken."""

METHODS = ("vanishing-point", "kmeans-road", "ufl:original", "ufl")
"""The three of Table I in its order, and our best reading."""

EXAMPLE = "0016E5_08049"
"""The picture of CamVid that Figs. 1 to 4 show: shadow and sun, cyclists, a car at the kerb."""


def small(image: Tensor, truth: Truth) -> tuple[Tensor, Truth]:
    """A picture (3,H,W) and its truth at the size at which P1 works and scores.

    160x120 for pictures of 4:3, 397x120 for KITTI's; the label by its nearest pixel, where the
    authors' program calls road whatever a bicubic label leaves above 0.
    """
    height, width = image.shape[-2:]
    rows, columns = WorkingShape().size(height, width)
    down = (2 * torch.arange(rows)[:, None] + 1) * height // (2 * rows)
    right = (2 * torch.arange(columns) + 1) * width // (2 * columns)
    reduced = Truth(truth.road[down, right], truth.valid[down, right])
    return bicubic(image, (rows, columns)), reduced


def sample_sets(data: Path) -> Iterator[Dataset]:
    """Every set of ``SETS``, with so many of its pictures, evenly spread."""
    for name, (folder, count) in SETS.items():
        yield every_kth(open_dataset(name, data / folder), count)


def example(data: Path) -> tuple[Tensor, Truth]:
    """The picture (3,120,160) of Figs. 1 to 4, and its truth."""
    camvid = open_dataset("camvid", data / "camvid")
    return small(*camvid.read(next(item for item in camvid.items if item.name == EXAMPLE)))


def learned(image: Tensor, **settings: object) -> tuple[LearnedFeatures, OriginalUflSettings]:
    """What the authors' program learns from an image (3,H,W), with the settings it has."""
    made = build_settings(OriginalUflSettings, settings)
    return learn_features(image, made.smoothing, made.dictionary, made.maps), made


def program_cues(image: Tensor, **settings: object) -> dict[str, Tensor]:
    """The stages of the authors' program on an image (3,H,W), by name, at its size."""
    return road_cues(*learned(image, **settings))


def panels(count: int, columns: int, width: float = 3.2) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels without axes, and those panels in reading order."""
    rows = -(-count // columns)
    figure = Figure(figsize=(width * columns, 0.85 * width * rows), layout="constrained")
    axes = [panel for row in figure.subplots(rows, columns, squeeze=False) for panel in row]
    for panel in axes:
        panel.set_axis_off()
    return figure, axes[:count]


def put(panel: Axes, title: str, picture: Tensor) -> None:
    """Show an image (3,H,W) in [0,1], or a map (H,W) from its least value to its greatest."""
    if picture.ndim == 3:
        panel.imshow(to_pixels(picture.clamp(0, 1)), interpolation="nearest")
    else:
        panel.imshow(picture.float().numpy(), cmap="cividis", interpolation="nearest")
    panel.set_title(title, fontsize=9)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG and say where."""
    figure.savefig(path, dpi=110)
    print(path)
