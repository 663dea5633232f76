"""What ``label`` writes for one picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from roadtorch.detector import checked_image
from roadtorch.io.atomic import make_folder
from roadtorch.io.image import read_image, write_jpeg, write_labels
from roadtorch.layout.classes import HORIZONTAL, layout_colours
from roadtorch.runs.batch import Job
from roadtorch.runs.claim import ELSEWHERE
from roadtorch.runs.index import Row
from roadtorch.settings import build_settings, parse_assignments

if TYPE_CHECKING:
    from roadtorch.layout.labeller import LabellerSettings

SUFFIXES = {"labels": ".png", "overlay": ".overlay.jpg"}
OVERLAY_SHARE = 0.5  # of the class's colour; the picture keeps the rest


def labeller_settings(support: str, assignments: Sequence[str]) -> "LabellerSettings":
    """The labeller's settings from ``--support`` and ``--set``; ConfigError as usual."""
    from roadtorch.layout.labeller import LabellerSettings

    return build_settings(LabellerSettings, {"support": support} | parse_assignments(assignments))


@dataclass(frozen=True)
class Labelling:
    """The work on one picture: read, label, write."""

    settings: "LabellerSettings"
    overlay: bool

    @torch.no_grad()
    def __call__(self, job: Job) -> Row:
        """Write the labels of one picture; the row's road share is that of horizontal."""
        from roadtorch.layout.labeller import label_layout

        start = perf_counter()
        image = checked_image(read_image(job.picture.path))
        labels = label_layout(image, self.settings).labels
        make_folder(job.output("").parent, ELSEWHERE)
        write_labels(job.output(SUFFIXES["labels"]), labels)
        if self.overlay:
            write_jpeg(job.output(SUFFIXES["overlay"]), colour_layout(image, labels))
        height, width = labels.shape
        share = float((labels == HORIZONTAL).to(torch.float64).mean())
        ms = 1000 * (perf_counter() - start)
        return Row(job.file, str(width), str(height), f"{ms:.0f}", f"{share:.4f}")


def colour_layout(image: Tensor, labels: Tensor) -> Tensor:
    """The image (3,H,W) tinted by class; unlabelled pixels are darkened to half."""
    return torch.lerp(image, layout_colours(labels), OVERLAY_SHARE)
