"""A detector that knows the truth of some rendered streets, and a data set of them."""

from pathlib import Path

import torch
from pydantic import Field
from torch import nn

from roadtorch.detectors.catalogue import list_detectors, register_detector
from roadtorch.detectors.entry import DetectorSettings
from roadtorch.testing.scenes import render_scene
from tests.streets import write_camvid

ORACLE = "test-oracle"
DECISION = {
    "isolated": "keep",
    "seed_area": {"height": 30.0, "width": 80.0},
    "ego": {"bottom": 0.0, "mask": "", "outline": []},
}
"""Default settings of every detector, apart from its threshold."""

GROUPS = ("0001TP", "0006R0", "0016E5")
SCENES = {f"{GROUPS[i % 3]}_{i}": render_scene(i, 48, 64) for i in range(6)}
TRUTH = {float(scene.image.double().sum()): scene for scene in SCENES.values()}


class OracleSettings(DetectorSettings):
    """Settings of the oracle."""

    doubt: float = Field(default=0.0, ge=0, le=1)


class Oracle(nn.Module):
    """Detector that looks up the truth by the sum of the image's pixels."""

    def __init__(self, settings: OracleSettings) -> None:
        super().__init__()
        self.doubt = settings.doubt

    def forward(self, image):
        scene = TRUTH[float(image.double().sum())]
        likelihood = scene.road.float() * (1 - self.doubt) + self.doubt / 2
        layout = torch.stack([scene.layout == kind for kind in range(3)]).float()
        return {"likelihood": likelihood, "layout": layout, "uniformity": likelihood}


def register_oracle() -> None:
    """Register the oracle as a detector, once."""
    if ORACLE not in list_detectors():
        register_detector(ORACLE, OracleSettings, summary="knows the truth")(Oracle)


def write_set(root: Path) -> Path:
    """Write the scenes as CamVid: two images of each of three groups."""
    write_camvid(root, "train", dict(list(SCENES.items())[:3]))
    write_camvid(root, "val", dict(list(SCENES.items())[3:]))
    return root
