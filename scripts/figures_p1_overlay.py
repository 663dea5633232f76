"""P1, Fig. 5: found and true road over the pictures, yellow, red and green."""

from collections.abc import Callable, Mapping
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset, Item, Truth, every_kth
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.metrics import count_mask, f_measure
from scripts.figures_p1_pictures import METHODS, panels, put, sample_sets, save, small

YELLOW, RED, GREEN = (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
"""Found and true, found alone, true alone."""

STRENGTH = 0.5
"""Of the colour over the picture."""

SHOWN = 3
"""Pictures of each set."""


def agreement(image: Tensor, mask: Tensor, truth: Truth) -> Tensor:
    """The image (3,H,W) with found and true road yellow, found alone red, true alone green.

    mask: bool (H,W). Pixels without truth are darkened, whatever was found there.
    """
    shown = torch.where(truth.valid, image, image / 3)
    areas = {
        YELLOW: mask & truth.road,
        RED: mask & ~truth.road,
        GREEN: truth.road & ~mask,
    }
    for colour, area in areas.items():
        tint = image.new_tensor(colour)[:, None, None]
        tinted = (1 - STRENGTH) * image + STRENGTH * tint
        shown = torch.where(area & truth.valid, tinted, shown)
    return shown


def figure5(data: Path, out: Path) -> None:
    """Results of the methods of Table I: yellow right, red too much, green missed."""
    chosen: list[tuple[Dataset, Item]] = []
    for dataset in sample_sets(data):
        chosen += [(dataset, item) for item in every_kth(dataset, SHOWN).items]
    figure, axes = panels(len(chosen) * len(METHODS), len(METHODS))
    for column, name in enumerate(METHODS):
        detector = load_detector(name)
        for row, (dataset, item) in enumerate(chosen):
            image, truth = small(*dataset.read(item))
            mask = detector.detect(image).mask
            value = float(f_measure(count_mask(mask, truth.road, truth.valid)))
            title = f"{name}, F {value:.2f}"
            title = title if column else f"{item.name}: {title}"
            put(axes[row * len(METHODS) + column], title, agreement(image, mask, truth))
    save(figure, out / "p1-fig5.png")


FIGURES: Mapping[str, Callable[[Path, Path], None]] = {"p1-fig5": figure5}
