"""What of a detector can be exported, and what its file says about itself."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from torch import Tensor

from roadtorch.detector import SMALLEST_SIDE, Detector
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.fusion import Fusion, FusionSettings
from roadtorch.detectors.layout import Cnn7, Cnn7Settings, Layout, LayoutSettings
from roadtorch.errors import ConfigError
from roadtorch.export.graph import OUTPUTS, EveryPixel, WholePictures
from roadtorch.io.atomic import digest_of
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.picture_network import ROAD, PictureNetwork
from roadtorch.layout.weights import FOR_PICTURES, WeightsFile, terms_of, weights_path
from roadtorch.version import __version__

CAN = ("fusion", "layout", "layout:cnn-7")

OWN_TERMS = "those of whoever trained them"

Reference = Callable[[Tensor], Mapping[str, Tensor]]
"""An image (3,H,W) in [0,1] → maps by name, as Python says them."""


@dataclass(frozen=True)
class Exportable:
    """A part of a detector as a graph.

    what: which part, in words. module: pictures uint8 (N,H,W,3) RGB → its ``outputs``.
    reference: what each of these has to equal. settings: those that have a part in it.
    shipped, weights: the name of the weights that are used unless others are given.
    """

    what: str
    module: WholePictures | EveryPixel
    reference: Reference
    settings: tuple[str, ...]
    shipped: str
    weights: WeightsFile


def exportable(detector: Detector) -> Exportable:
    """The part of a detector that can be exported.

    Raises ConfigError for a detector that has none, and for settings that have no part in it.
    """
    analysis, settings = detector.analysis, detector.settings
    if isinstance(analysis, Fusion) and isinstance(settings, FusionSettings):
        what = "its learned road, layout and ego car, without the superpixels"
        part = _whole_pictures(what, analysis.network, ROAD, settings.weights)
    elif isinstance(analysis, Layout) and isinstance(settings, LayoutSettings):
        what = "its learned layout and ego car, without the labeller"
        part = _whole_pictures(what, analysis.network, HORIZONTAL, settings.weights)
    elif isinstance(analysis, Cnn7) and isinstance(settings, Cnn7Settings):
        module = EveryPixel(analysis.network, settings.working)
        kept = ("weights", "threshold", "working")
        what, said = "its likelihood and layout", _detected(detector)
        part = Exportable(what, module, said, kept, "cnn-7", settings.weights)
    else:
        raise ConfigError(detector.name, "cannot be exported", f"those that can: {', '.join(CAN)}")
    _refuse_others(detector, part.settings)
    return part


def _whole_pictures(
    what: str, network: PictureNetwork, place: int, weights: WeightsFile
) -> Exportable:
    def learned(image: Tensor) -> Mapping[str, Tensor]:
        found = network.cues(image)
        likelihood = found["road"] if place == ROAD else found["layout"][place]
        return {"likelihood": likelihood, "layout": found["layout"], "ego": found["ego"]}

    module = WholePictures(network, place)
    return Exportable(what, module, learned, ("weights", "threshold"), FOR_PICTURES, weights)


def _detected(detector: Detector) -> Reference:
    def said(image: Tensor) -> Mapping[str, Tensor]:
        detection = detector.detect(image)
        return {"likelihood": detection.likelihood, "layout": detection.cues["layout"]}

    return said


def _refuse_others(detector: Detector, kept: tuple[str, ...]) -> None:
    """ConfigError where settings were changed that have no part in what is exported."""
    usual = detector_entry(detector.name).configured({}).model_dump()
    for key, value in detector.settings.model_dump().items():
        if key not in kept and value != usual[key]:
            raise ConfigError(key, "has no part in what is exported", "leave it out")


def notes_of(detector: Detector, part: Exportable) -> dict[str, str]:
    """What the file says about itself, by name."""
    path = weights_path(part.weights.file or part.shipped)
    stated = terms_of(path)
    terms = f"{stated} (see {path.stem}.md beside the weights)" if stated else OWN_TERMS
    return {
        "roadtorch": __version__,
        "detector": detector.name,
        "part": part.what,
        "input": "image: uint8 (N, H, W, 3)",
        "colour_order": "RGB",
        "range": "0 to 255",
        "smallest_side": str(SMALLEST_SIDE),
        **{f"output.{name}": OUTPUTS[name] for name in part.module.outputs},
        "threshold": f"{detector.settings.threshold:g}",
        "weights": path.name,
        "weights_sha256": digest_of(path),
        "terms": f"{terms}; the code is Apache-2.0",
    }
