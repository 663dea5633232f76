"""Label images of machine labels of the scene layout."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.image import write_labels, write_rgb
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import validate_image
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import HORIZONTAL, colour_layout
from roadtorch.layout.labeller import LabellerSettings, label_layout

LABEL_SUFFIXES = {"labels": ".png", "overlay": ".overlay.jpg"}
LAYOUT_OPACITY = 0.5  # of class colours in the overlay
LABELS_CUE = "layout_labels"


@dataclass(frozen=True)
class Labelling:
    """The labeller as a detector: sky 0, vertical 1, horizontal 2, unlabelled 255."""

    settings: LabellerSettings

    @torch.no_grad()
    def __call__(self, image: Tensor) -> Detection:
        """Label an image (3, H, W): labels are the cue ``layout_labels``, horizontal the mask."""
        image = validate_image(image)
        labels = label_layout(image, self.settings).labels
        mask = labels == HORIZONTAL
        return Detection(mask.to(image.dtype), mask, {LABELS_CUE: labels}, image=image)


@dataclass(frozen=True)
class LabelWriter:
    """A writer of label images and overlays; kinds: see ``LABEL_SUFFIXES``."""

    folder: Path
    kinds: Sequence[str]

    @property
    def suffixes(self) -> Sequence[str]:
        """Suffixes of its files."""
        return [LABEL_SUFFIXES[kind] for kind in self.kinds]

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write the labels, and the image tinted by class, with unlabelled pixels darkened."""
        labels, image = detection.cues[LABELS_CUE], detection.image
        assert image is not None
        write_labels(self.folder / f"{item.name}{LABEL_SUFFIXES['labels']}", labels)
        if "overlay" in self.kinds:
            tinted = torch.lerp(image, colour_layout(labels), LAYOUT_OPACITY)
            write_rgb(self.folder / f"{item.name}{LABEL_SUFFIXES['overlay']}", tinted)
        return {}
