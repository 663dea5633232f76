"""Detectors that take the ground of the scene layout for road."""

from functools import partial

from pydantic import Field
from torch import Tensor, nn

from roadtorch.detectors.entry import (
    TUNED_THRESHOLD,
    Analysis,
    Entry,
    Threshold,
    WorkingSettings,
    use_inference_mode,
)
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.labeller import HorizonSettings, label_at_image_size
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import WeightsFile, load_configured_network


class LabellerDetectorSettings(WorkingSettings):
    """Settings of the layout labeller as a road detector."""

    threshold: Threshold = Field(default=0.92, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: HorizonSettings = HorizonSettings()


class Cnn7Settings(WorkingSettings):
    """Settings of CNN-7 as a road detector."""

    threshold: Threshold = Field(default=0.425, description=TUNED_THRESHOLD)
    weights: WeightsFile = WeightsFile()


@use_inference_mode
def labeller_road(image: Tensor, settings: LabellerDetectorSettings) -> dict[str, Tensor]:
    """Return the ground of the layout that the labeller computes from the image alone."""
    layout = label_at_image_size(image, settings.labeller, settings.superpixels)
    return {
        "likelihood": layout.potentials[HORIZONTAL],
        "layout": layout.potentials,
        "layout_labels": layout.labels,
    }


class Cnn7(nn.Module):
    """Ground of the layout of a patch network, pixel by pixel (P2, section 3)."""

    def __init__(self, settings: Cnn7Settings) -> None:
        super().__init__()
        self.network = load_configured_network(settings.weights, "cnn-7", PatchNetwork)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """Compute the cues of an image (3, H, W) in [0, 1]."""
        potentials = self.network.potentials(image)
        return {"likelihood": potentials[HORIZONTAL], "layout": potentials}


ENTRIES = (
    Entry(
        "layout:cnn-7",
        "ground of the layout by CNN-7, with our training (Álvarez 2012)",
        Cnn7Settings,
        Cnn7,
    ),
    Entry(
        "layout:paper",
        "ground of the layout by CNN-7, trained as in the paper (Álvarez 2012)",
        Cnn7Settings,
        Cnn7,
        defaults={"threshold": 0.211, "weights": {"file": "cnn-7-paper"}},
    ),
    Entry(
        "labeller",
        "ground of the machine labels of the scene layout, without training",
        LabellerDetectorSettings,
        partial(Analysis, labeller_road),
    ),
    Entry(
        "labeller:untuned",
        "labeller with constants from geometry and round numbers, tuned on no label",
        LabellerDetectorSettings,
        partial(Analysis, labeller_road),
        defaults={"threshold": 0.5, "labeller": {"constants": "untuned"}},
    ),
)
