"""What of a detector can be exported, what its file says about itself, and whether it says what
Python says."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from roadtorch.detector import SMALLEST_SIDE, Detector
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.fusion import Fusion, FusionSettings
from roadtorch.detectors.layout import Cnn7, Cnn7Settings, Layout, LayoutSettings
from roadtorch.errors import ConfigError
from roadtorch.export.graph import OUTPUTS, EveryPixel, WholePictures
from roadtorch.io.atomic import digest_of
from roadtorch.io.image import from_pixels, to_pixels
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.picture_network import ROAD, PictureNetwork
from roadtorch.layout.weights import FOR_PICTURES, WeightsFile, terms_of, weights_path
from roadtorch.scenes.street import render_scene
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
    # Not what is made of it, as fusion:large: one of its networks alone is another detector.
    if type(analysis) is Fusion and isinstance(settings, FusionSettings):
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


# --- whether a file says what Python says ---------------------------------------------


BOUND = 1e-4
"""How far a file may be off. Ours: a fortieth of the step between two grey levels."""

SIZES = ((48, 64), (121, 317), (360, 480))
"""Height and width of the rendered pictures on which it is tried: below the network's size, above
it, and above the size at which detectors think."""

Run = Callable[[np.ndarray], Mapping[str, np.ndarray]]
"""Pictures uint8 (N,H,W,3) RGB → maps by name, by a runtime that has read a file."""


@dataclass(frozen=True)
class Parity:
    """How far a file is off what Python says: ``most`` anywhere, ``mean`` over all pixels.

    where: the output, and the size of the picture, with the most. pictures: how many were tried.
    """

    most: float
    mean: float
    where: str
    pictures: int


def rendered_batches() -> Iterator[np.ndarray]:
    """Pictures uint8 (2,H,W,3) RGB, by day and at dusk, of each of ``SIZES``."""
    for seed, (height, width) in enumerate(SIZES):
        scenes = (render_scene(seed, height, width, dusk=dusk) for dusk in (0.0, 0.9))
        yield np.stack([to_pixels(scene.image) for scene in scenes])


def parity(run: Run, reference: Reference, batches: Iterable[np.ndarray]) -> Parity:
    """How far ``run`` is off the reference on batches of pictures uint8 (N,H,W,3), at least one."""
    seen = [one for batch in batches for one in _differences(run(batch), reference, batch)]
    most, where = max((float(apart.max()), where) for where, apart in seen)
    pixels = sum(apart.numel() for _, apart in seen)
    mean = sum(float(apart.double().sum()) for _, apart in seen) / pixels
    outputs = len({where.split()[0] for where, _ in seen})
    return Parity(most, mean, where, len(seen) // outputs)


def _differences(
    found: Mapping[str, np.ndarray], reference: Reference, batch: np.ndarray
) -> Iterator[tuple[str, Tensor]]:
    """For each picture and output: name and size, and how far it is off; NaN is endless."""
    for at, pixels in enumerate(batch):
        wanted = reference(from_pixels(pixels))
        height, width = pixels.shape[:2]
        for name, maps in found.items():
            apart = (torch.from_numpy(maps[at]) - wanted[name]).abs()
            yield f"{name} at {width}×{height}", apart.nan_to_num(torch.inf)
