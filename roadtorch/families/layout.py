"""Detectors that take the ground of the scene layout for road."""

from collections.abc import Mapping

from pydantic import Field
from torch import Tensor

from roadtorch.detectors import Analysis, Entry
from roadtorch.families.decision import THRESHOLD, Decision
from roadtorch.families.networks import Weights, WithNetwork, network_of
from roadtorch.layout.labeller import HORIZONTAL, LabellerSettings, decide_layout, label_layout
from roadtorch.layout.network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.pool import pooled
from roadtorch.working import Superpixels, at_working_size

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
