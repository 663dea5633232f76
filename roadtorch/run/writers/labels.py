"""Label images of machine labels of the scene layout."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.image import write_labels
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import validate_image
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.labeller import LabellerSettings, label_layout

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
        return Detection(mask.to(image.dtype), mask, {LABELS_CUE: labels})


@dataclass(frozen=True)
class LabelWriter:
    """A writer of label images, NAME.png."""

    folder: Path
    suffixes: Sequence[str] = (".png",)

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write the labels."""
        write_labels(self.folder / f"{item.name}.png", detection.cues[LABELS_CUE])
        return {}
