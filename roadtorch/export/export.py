"""Detectors as files that run without Python."""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from torch import Tensor

from roadtorch.detector import MIN_SIDE, Detector
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.fusion import Fusion, FusionSettings
from roadtorch.detectors.layout import Cnn7, Cnn7Settings, Layout, LayoutSettings
from roadtorch.errors import ConfigError, InputError, unknown_name
from roadtorch.export.files import Run, open_onnx, open_openvino, write_onnx, write_openvino
from roadtorch.export.graph import OUTPUTS, EveryPixel, Platt, WholePictures, calibrated
from roadtorch.io.atomic import atomic, digest_of, make_folder
from roadtorch.io.image import from_pixels, to_pixels
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.picture_network import ROAD
from roadtorch.layout.weights import (
    FOR_PICTURES,
    WeightsFile,
    WholePictureNetwork,
    terms_of,
    weights_path,
)
from roadtorch.scenes.street import render_scene
from roadtorch.version import __version__

# --- what of a detector can be exported --------------------------------------------------


CAN = ("fusion", "layout", "layout:cnn-7")

ISOLATED = "dropping of isolated road"

OWN_TERMS = "those of whoever trained them"

Reference = Callable[[Tensor], Mapping[str, Tensor]]
"""An image (3,H,W) in [0,1] → maps by name, as Python says them."""


@dataclass(frozen=True)
class Exportable:
    """A part of a detector as a graph.

    what: which part, in words. lacks: what Python does beside it.
    module: pictures uint8 (N,H,W,3) RGB → its ``outputs``.
    reference: what each of these has to equal. settings: those that have a part in it.
    shipped, weights: the name of the weights that are used unless others are given.
    """

    what: str
    lacks: str
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
        what = "its learned road, layout and ego car"
        lacks = f"superpixels, outlines that follow the picture, {ISOLATED}, trust"
        learned, calibration = settings.learned, settings.calibration
        weight = learned.weight + learned.detail
        platt = Platt(weight, calibration.centre, calibration.temperature)
        part = _whole_pictures(what, lacks, analysis.network, ROAD, settings.weights, platt)
    elif isinstance(analysis, Layout) and isinstance(settings, LayoutSettings):
        what, lacks = "its learned layout and ego car", f"the labeller, {ISOLATED}"
        part = _whole_pictures(what, lacks, analysis.network, HORIZONTAL, settings.weights, None)
    elif isinstance(analysis, Cnn7) and isinstance(settings, Cnn7Settings):

        def detected(image: Tensor) -> Mapping[str, Tensor]:
            detection = detector.detect(image)
            return {"likelihood": detection.likelihood, "layout": detection.cues["layout"]}

        module = EveryPixel(analysis.network, settings.working)
        kept, what = ("weights", "threshold", "working"), "its likelihood and layout"
        part = Exportable(what, ISOLATED, module, detected, kept, "cnn-7", settings.weights)
    else:
        raise ConfigError(detector.name, "cannot be exported", f"those that can: {', '.join(CAN)}")
    usual = detector_entry(detector.name).configured({}).model_dump()
    for key, value in settings.model_dump().items():
        if key not in part.settings and value != usual[key]:
            raise ConfigError(key, "has no part in what is exported", "leave it out")
    return part


def _whole_pictures(
    what: str,
    lacks: str,
    network: WholePictureNetwork,
    place: int,
    weights: WeightsFile,
    platt: Platt | None,
) -> Exportable:
    def learned(image: Tensor) -> Mapping[str, Tensor]:
        found = network.cues(image)
        likelihood = found["road"] if place == ROAD else found["layout"][place]
        if platt is not None:
            likelihood = calibrated(likelihood, found["ego"], platt)
        return {"likelihood": likelihood, "layout": found["layout"], "ego": found["ego"]}

    kept = ("weights", "threshold")
    if platt is not None:
        kept += ("learned", "calibration", "network_scale")
    module = WholePictures(network, place, platt)
    return Exportable(what, lacks, module, learned, kept, FOR_PICTURES, weights)


def notes_of(detector: Detector, part: Exportable) -> dict[str, str]:
    """What the file says about itself, by name."""
    path = weights_path(part.weights.file or part.shipped)
    stated = terms_of(path)
    terms = f"{stated} (see {path.stem}.md beside the weights)" if stated else OWN_TERMS
    return {
        "roadtorch": __version__,
        "detector": detector.name,
        "part": part.what,
        "lacks": part.lacks,
        "input": "image: uint8 (N, H, W, 3)",
        "colour_order": "RGB",
        "range": "0 to 255",
        "smallest_side": str(MIN_SIDE),
        **{f"output.{name}": OUTPUTS[name] for name in part.module.outputs},
        "threshold": f"{detector.settings.threshold:g}",
        "weights": path.name,
        "weights_sha256": digest_of(path),
        "terms": f"{terms}; the code is Apache-2.0",
    }


# --- whether a file says what Python says -----------------------------------------------


BOUND = 1e-4
"""How far a file may be off. Ours: a fortieth of the step between two grey levels."""

SIZES = ((48, 64), (121, 317), (360, 480))
"""Height and width of the rendered pictures on which it is tried: below the network's size, above
it, and above the size at which detectors think."""


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


# --- writing it -------------------------------------------------------------------------


@dataclass(frozen=True)
class Format:
    """A format of files. suffixes: how they end; the one that is opened is the first.

    needs: the packages of the extra by its name. write: module, notes, path. open: path, threads.
    """

    suffixes: tuple[str, ...]
    needs: tuple[str, ...]
    write: Callable[[WholePictures | EveryPixel, Mapping[str, str], Path], None]
    open: Callable[[Path, int], Run]


FORMATS: Mapping[str, Format] = {
    "onnx": Format((".onnx",), ("onnx", "onnxscript", "onnxruntime"), write_onnx, open_onnx),
    "openvino": Format(
        (".xml", ".bin"), ("openvino", "onnx", "onnxscript"), write_openvino, open_openvino
    ),
}


@dataclass(frozen=True)
class Exported:
    """What was written: files, what they say about themselves, and how far they are off."""

    files: tuple[Path, ...]
    notes: Mapping[str, str]
    parity: Parity


def export_detector(detector: Detector, out: Path, kind: str) -> Exported:
    """Write what can be exported of a detector in a format, once it says what Python says.

    Raises ConfigError for what cannot be exported, an unknown format, another suffix than the
    format has, and a missing extra; InputError when the file would be more than ``BOUND`` off
    (then nothing is written), and when it cannot be written.
    """
    made = format_named(kind)
    if out.suffix != made.suffixes[0]:
        what = f"does not end as {kind} files do"
        raise ConfigError(out, what, f"name it {out.stem or 'road'}{made.suffixes[0]}")
    part = exportable(detector)
    make_folder(out.parent)
    notes = notes_of(detector, part)
    with TemporaryDirectory(prefix="roadtorch.") as folder:
        path = Path(folder) / out.name
        made.write(part.module, notes, path)
        run = made.open(path, torch.get_num_threads())
        found = parity(run, part.reference, rendered_batches())
        if not found.most <= BOUND:
            what = f"would be {found.most:.2g} off in its {found.where}, more than {BOUND:g}"
            raise InputError(out, what, "nothing was written; try other versions of the extra")
        files = tuple(out.with_suffix(suffix) for suffix in made.suffixes)
        for file in reversed(files):
            with atomic(file) as temporary:
                shutil.copyfile(path.with_suffix(file.suffix), temporary)
    return Exported(files, notes, found)


def format_named(kind: str) -> Format:
    """The format of that name; ConfigError where there is none, or its extra is missing."""
    if kind not in FORMATS:
        raise unknown_name("format", kind, FORMATS)
    missing = [name for name in FORMATS[kind].needs if find_spec(name) is None]
    if missing:
        what = f"needs {', '.join(missing)}: not installed"
        raise ConfigError(f"format {kind}", what, f"pip install 'roadtorch[{kind}]'")
    return FORMATS[kind]
