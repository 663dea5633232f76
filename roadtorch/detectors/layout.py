"""Networks inside detectors: which weights, and how they travel with the detector."""

from collections.abc import Callable, Mapping

from pydantic import Field
from torch import Tensor, nn

from roadtorch.detector import THRESHOLD, Analysis, Decision, Entry
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.labeller import LabellerSettings, decide_layout, label_layout
from roadtorch.layout.opinion_pool import pooled
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import Weights, network_of
from roadtorch.superpixels import Superpixels
from roadtorch.working_size import at_working_size


class WithNetwork(nn.Module):
    """An analysis that asks a network, whose weights become part of the detector."""

    def __init__(
        self, network: nn.Module, analyse: Callable[[Tensor], Mapping[str, Tensor]]
    ) -> None:
        super().__init__()
        self.network = network
        self._analyse = analyse

    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        return self._analyse(image)


SHARE = "weight of the network against the labels made in this picture"


class LabellerDetectorSettings(Decision):
    """The layout labeller as a road detector."""

    threshold: float = Field(default=0.92, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()


class Cnn7Settings(Decision):
    """CNN-7 as a road detector."""

    threshold: float = Field(default=0.637, ge=0, le=1, description=THRESHOLD)
    weights: Weights = Weights()


class LayoutSettings(Decision):
    """The layout by a network for whole pictures and by the labeller."""

    threshold: float = Field(default=0.783, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()
    weights: Weights = Weights()
    share: float = Field(default=0.7, ge=0, le=1, description=SHARE)


def _labeller(settings: LabellerDetectorSettings) -> Analysis:
    def analyse(image: Tensor) -> dict[str, Tensor]:
        found = label_layout(image, settings.labeller, settings.working, settings.superpixels)
        return {
            "likelihood": found.potentials[HORIZONTAL],
            "layout": found.potentials,
            "layout_labels": found.labels,
        }

    return analyse


def _cnn7(settings: Cnn7Settings) -> Analysis:
    network = network_of(settings.weights, "cnn-7", PatchNetwork)

    def analyse(image: Tensor) -> dict[str, Tensor]:
        potentials = network.potentials(image)
        return {"likelihood": potentials[HORIZONTAL], "layout": potentials}

    return WithNetwork(network, at_working_size(analyse, settings.working))


def _layout(settings: LayoutSettings) -> Analysis:
    network = network_of(settings.weights, "layout", PictureNetwork)

    def analyse(image: Tensor) -> Mapping[str, Tensor]:
        own = label_layout(image, settings.labeller, settings.working, settings.superpixels)
        learned = network.cues(image)
        potentials = pooled(own.potentials, learned["layout"], settings.share)
        return {
            "likelihood": potentials[HORIZONTAL],
            "layout": potentials,
            "layout_labels": _decided(potentials, settings.labeller),
            "learned_road": learned["road"],
        }

    return WithNetwork(network, at_working_size(analyse, settings.working))


def _decided(potentials: Tensor, settings: LabellerSettings) -> Tensor:
    """Labels (H,W) of potentials (3,H,W); 255 in doubt."""
    labels = decide_layout(potentials.flatten(1).T, settings)
    return labels.reshape(potentials.shape[1:])


ENTRIES = (
    Entry(
        "layout",
        "layout by a network and the labeller: the best we know",
        LayoutSettings,
        _layout,
    ),
    Entry("layout:cnn-7", "ground of the layout by CNN-7 (P2)", Cnn7Settings, _cnn7),
    Entry(
        "labeller",
        "ground of the machine-made scene layout, no training",
        LabellerDetectorSettings,
        _labeller,
    ),
)
