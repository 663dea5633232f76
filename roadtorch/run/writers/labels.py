"""Machine labels of the scene layout, as images of labels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.image import write_jpeg, write_labels
from roadtorch.detectors.detector import Detection, checked_image
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import HORIZONTAL, layout_colours
from roadtorch.layout.labeller import LabellerSettings, label_layout

SUFFIXES = {"labels": ".png", "overlay": ".overlay.jpg"}
LAYOUT_SHARE = 0.5  # of the class's colour; the image keeps the rest
LABELS = "layout_labels"


@dataclass(frozen=True)
class Labelling:
    """What labels an image: sky 0, vertical 1, horizontal 2, unlabelled 255."""

    settings: LabellerSettings

    @torch.no_grad()
    def __call__(self, image: Tensor) -> Detection:
        """The labels of an image (3,H,W) as the cue ``layout_labels``; horizontal is the mask."""
        image = checked_image(image)
        labels = label_layout(image, self.settings).labels
        mask = labels == HORIZONTAL
        return Detection(mask.to(image.dtype), mask, {LABELS: labels}, image=image)


@dataclass(frozen=True)
class Labels:
    """The files of a labelled image; kinds: see ``SUFFIXES``."""

    folder: Path
    kinds: Sequence[str]

    @property
    def suffixes(self) -> Sequence[str]:
        """How the names of its files end."""
        return [SUFFIXES[kind] for kind in self.kinds]

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write the labels, and the image tinted by class; what is unlabelled is darkened."""
        labels, image = detection.cues[LABELS], detection.image
        assert image is not None
        write_labels(self.folder / f"{item.name}{SUFFIXES['labels']}", labels)
        if "overlay" in self.kinds:
            tinted = torch.lerp(image, layout_colours(labels), LAYOUT_SHARE)
            write_jpeg(self.folder / f"{item.name}{SUFFIXES['overlay']}", tinted)
        return {}
