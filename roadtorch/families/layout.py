"""Detectors that take the ground of the scene layout for road."""

from pydantic import Field
from torch import Tensor

from roadtorch.detectors import Analysis, Entry
from roadtorch.families.decision import THRESHOLD, Decision
from roadtorch.layout.labeller import HORIZONTAL, LabellerSettings, label_layout
from roadtorch.working import Superpixels


class LabellerDetectorSettings(Decision):
    """The layout labeller as a road detector."""

    threshold: float = Field(default=0.92, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()


def _labeller(settings: LabellerDetectorSettings) -> Analysis:
    def analyse(image: Tensor) -> dict[str, Tensor]:
        found = label_layout(image, settings.labeller, settings.working, settings.superpixels)
        return {
            "likelihood": found.potentials[HORIZONTAL],
            "layout": found.potentials,
            "layout_labels": found.labels,
        }

    return analyse


ENTRIES = (
    Entry(
        "labeller",
        "ground of the machine-made scene layout, no training",
        LabellerDetectorSettings,
        _labeller,
    ),
)
