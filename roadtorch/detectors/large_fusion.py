"""`fusion` with a second network, which knows the looks of things: accuracy before time."""

from collections.abc import Mapping

from pydantic import Field
from torch import Tensor

from roadtorch.detector import Entry
from roadtorch.detectors.fusion import Fusion, FusionSettings, LearnedRoad, RoadCalibration
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import Share
from roadtorch.layout.weights import WeightsFile, network_of

FOR_LARGE = "backbone-free"
"""The shipped weights of the second network."""


class LargeFusionSettings(FusionSettings):
    """`fusion` and how far its second network is trusted."""

    backbone: WeightsFile = WeightsFile()
    second: Share = Field(default=0.7, description="of the second network, the first has the rest")
    learned: LearnedRoad = LearnedRoad(weight=1.0, detail=1.0)
    calibration: RoadCalibration = RoadCalibration(centre=-1.0)


class LargeFusion(Fusion):
    """`fusion` whose knowledge from other streets is that of two networks.

    The second has a backbone that has seen ImageNet's object labels, and no road label.
    """

    def __init__(self, settings: LargeFusionSettings) -> None:
        super().__init__(settings)
        self.second = settings.second
        self.backbone = network_of(settings.backbone, FOR_LARGE, BackboneNetwork)

    def learned(self, image: Tensor) -> Mapping[str, Tensor]:
        """The mean of both networks' potentials, by the settings' share."""
        first, second = self.network.cues(image), self.backbone.cues(image)
        return {name: maps.lerp(second[name], self.second) for name, maps in first.items()}


ENTRIES = (
    Entry(
        "fusion:large",
        "fusion with a second, larger network: three times the time, more often right",
        LargeFusionSettings,
        LargeFusion,
    ),
)
