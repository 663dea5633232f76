"""Detectors as files that run without Python."""

import logging
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.base.atomic import atomic, digest_of, make_folder
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import from_pixels, to_pixels
from roadtorch.base.version import __version__
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.detector import MIN_SIDE, Detector
from roadtorch.detectors.fusion import Fusion, FusionSettings
from roadtorch.detectors.layout import Cnn7, Cnn7Settings
from roadtorch.imaging.resize import at_image_size, at_work, resized, size_of
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.weights import FOR_IMAGES, terms_of, weights_path
from roadtorch.road.outlines import outlined
from roadtorch.testing.scenes import render_scene

# --- what of a detector can be exported --------------------------------------------------


CAN = ("fusion", "layout:cnn-7")

ISOLATED = "dropping of isolated road"

OWN_TERMS = "those of whoever trained them"

Steps = Callable[[Tensor], Mapping[str, Tensor]]
"""An image (3,H,W) in [0,1] → maps by name, of any of which a graph may be traced."""

OUTPUTS: Mapping[str, str] = {
    "likelihood": "float32 (N, H, W): how road-like each pixel is, 0 to 1",
    "layout": "float32 (N, 3, H, W): sky, vertical, horizontal, 0 to 1",
    "ego": "float32 (N, H, W): the vehicle that carries the camera, 0 to 1",
    "seed_area": "float32 (N, H, W): where road surely is, 0 or 1; isolated road does not touch it",
    "trust": "float32 (N): the F to expect of the mask, 0 to 1",
}
"""What files give, by name."""


@dataclass(frozen=True)
class Exportable:
    """A part of a detector as a function, which a graph is traced of.

    what: which part, in words. lacks: what Python does beside it. steps: an image (3,H,W) in
    [0,1] → the outputs by name; where it is traced, a batch (N,3,H,W). outputs: some of
    ``OUTPUTS``. settings: those that have a part in it. weights: the files of its networks'.
    """

    problem: str
    lacks: str
    steps: Steps
    outputs: tuple[str, ...]
    settings: tuple[str, ...]
    weights: tuple[Path, ...]


def exportable(detector: Detector) -> Exportable:
    """The part of a detector that can be exported.

    Raises ConfigError for a detector that has none, and for settings that have no part in it.
    """
    part, usual = part_of(detector), detector_entry(detector.name).configured({}).model_dump()
    for key, value in detector.settings.model_dump().items():
        if key not in part.settings and value != usual[key]:
            raise ConfigError(key, "has no part in what is exported", "leave it out")
    return part


def part_of(detector: Detector) -> Exportable:
    """The same whatever its settings; ConfigError for a detector that has none."""
    analysis, settings = detector.analysis, detector.settings
    if isinstance(analysis, Fusion) and isinstance(settings, FusionSettings):
        part = Exportable(
            "its road, layout, ego car and trust",
            f"filling of thin holes, {ISOLATED}",
            partial(fused_maps, analysis, settings),
            tuple(OUTPUTS),
            (
                *("weights", "second", "threshold", "calibration"),
                *("cuts", "working", "seed_area"),
            ),
            tuple(
                weights_path(file)
                for file in (settings.weights.file or FOR_IMAGES, settings.second.file)
                if file
            ),
        )
    elif isinstance(analysis, Cnn7) and isinstance(settings, Cnn7Settings):
        part = Exportable(
            "its likelihood and layout",
            ISOLATED,
            partial(ground_maps, analysis, settings),
            ("likelihood", "layout"),
            ("weights", "threshold", "working"),
            (weights_path(settings.weights.file or "cnn-7"),),
        )
    else:
        raise ConfigError(detector.name, "cannot be exported", f"those that can: {', '.join(CAN)}")
    return part


def fused_maps(analysis: Fusion, settings: FusionSettings, image: Tensor) -> dict[str, Tensor]:
    """All of `fusion` but what takes connected regions.

    Thin holes are not filled, and isolated road is not dropped. In the graph images are followed
    at their own size, however large that is.
    """
    small, full = at_work(image, settings.working), size_of(image)
    cues = analysis(small)
    likelihood = outlined(cues, small, image, settings.working, settings.threshold)
    if not torch.compiler.is_exporting():
        likelihood = resized(likelihood, full)
    hidden = at_image_size(cues["ego"], full)
    likelihood = likelihood.masked_fill(hidden, 0)
    mask = at_image_size(likelihood >= settings.threshold, size_of(small))
    return {
        "likelihood": likelihood,
        "layout": resized(cues["layout"], full),
        "ego": hidden.float(),
        "seed_area": at_image_size(cues["seed_area"], full).float(),
        "trust": torch.as_tensor(analysis.judge(mask, cues).trust),
    }


def ground_maps(analysis: Cnn7, settings: Cnn7Settings, image: Tensor) -> dict[str, Tensor]:
    """All of `layout:cnn-7` but the dropping of isolated road."""
    layout = analysis.network.potentials(at_work(image, settings.working))
    layout = resized(layout, size_of(image))
    return {"likelihood": layout[..., HORIZONTAL, :, :], "layout": layout}


def notes_of(detector: Detector, part: Exportable) -> dict[str, str]:
    """What the file says about itself, by name."""
    return {
        "roadtorch": __version__,
        "detector": detector.name,
        "part": part.problem,
        "lacks": part.lacks,
        "input": "image: uint8 (N, H, W, 3)",
        "colour_order": "RGB",
        "range": "0 to 255",
        "smallest_side": str(MIN_SIDE),
        **{f"output.{name}": OUTPUTS[name] for name in part.outputs},
        "threshold": f"{detector.settings.threshold:g}",
        "weights": ", ".join(file.name for file in part.weights),
        "weights_sha256": ", ".join(map(digest_of, part.weights)),
        "terms": f"{'; '.join(map(terms_with_card, part.weights))}; the code is Apache-2.0",
    }


def terms_with_card(weights: Path) -> str:
    """What weights may be used for, and where that is said."""
    stated = terms_of(weights)
    return f"{stated} (see {weights.stem}.md beside the weights)" if stated else OWN_TERMS


# --- whether a file says what Python says -----------------------------------------------


Run = Callable[[np.ndarray], Mapping[str, np.ndarray]]
"""Images uint8 (N,H,W,3) RGB → maps by name, by a runtime that has read a file."""

BOUND = 1e-4
"""How far a file may be off. Ours: a fortieth of the step between two grey levels."""

SIZES = ((48, 64), (121, 317), (360, 480))
"""Height and width of the rendered images on which it is tried: below the network's size, above
it, and above the size at which detectors think."""


@dataclass(frozen=True)
class Parity:
    """How far a file is off what Python says: ``most`` anywhere, ``mean`` over all pixels.

    where: the output, and the size of the image, with the most. images: how many were tried.
    """

    most: float
    where: str
    mean: float
    images: int


def rendered_batches() -> Iterator[np.ndarray]:
    """Images uint8 (2,H,W,3) RGB, by day and at dusk, of each of ``SIZES``."""
    for seed, (height, width) in enumerate(SIZES):
        scenes = (render_scene(seed, height, width, dusk=dusk) for dusk in (0.0, 0.9))
        yield np.stack([to_pixels(scene.image) for scene in scenes])


def parity(run: Run, steps: Steps, batches: Iterable[np.ndarray]) -> Parity:
    """How far ``run`` is off the steps in Python on batches of images uint8 (N,H,W,3).

    What is no number is endlessly far.
    """
    images, pixels, total = 0, 0, 0.0
    extremes: list[tuple[float, str]] = []
    for batch in batches:
        maps = run(batch)
        for at, image in enumerate(batch):
            expected = steps(from_pixels(image))
            height, width = image.shape[:2]
            images += 1
            for name, values in maps.items():
                difference = (torch.as_tensor(values[at]) - expected[name]).abs()
                difference = difference.nan_to_num(torch.inf)
                extremes.append((float(difference.max()), f"{name} at {width}×{height}"))
                pixels += difference.numel()
                total += float(difference.double().sum())
    return Parity(*max(extremes), total / pixels, images)


# --- writing it -------------------------------------------------------------------------


OPSET = 18

EXAMPLE = (2, 240, 320, 3)
"""The shape of the images that the graph is traced with; no number of it stays but the 3."""


class Graph(nn.Module):
    """Steps as a module of the exporter: images uint8 (N,H,W,3) RGB → the outputs, in order.

    analysis: what has their weights.
    """

    def __init__(self, analysis: nn.Module, steps: Steps, outputs: Sequence[str]) -> None:
        super().__init__()
        self.analysis = analysis
        self.steps = steps
        self.outputs = outputs

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """The outputs of a batch."""
        maps = self.steps(image.permute(0, 3, 1, 2).to(torch.float32) / 255)
        return tuple(maps[name] for name in self.outputs)


def write_onnx(module: Graph, notes: Mapping[str, str], path: Path) -> None:
    """Write a graph with notes about it; needs onnx and onnxscript.

    The same module and notes give the same bytes, wherever they are made.
    """
    with quiet_exporter(), torch.no_grad():
        program = torch.onnx.export(
            module,
            (torch.zeros(EXAMPLE, dtype=torch.uint8),),
            input_names=["image"],
            output_names=list(module.outputs),
            dynamic_shapes=({0: "N", 1: "H", 2: "W"},),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    program.model.producer_name, program.model.producer_version = "roadtorch", __version__
    program.model.metadata_props.update(notes)
    for node in program.model.graph.all_nodes():
        node.metadata_props.clear()  # where in the sources on this machine it came from
    program.save(str(path))


def open_onnx(path: Path, threads: int) -> Run:
    """What runs an ONNX file on so many threads, by ONNX Runtime."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]

    def run(images: np.ndarray) -> dict[str, np.ndarray]:
        maps: list[Any] = list(session.run(names, {"image": images}))
        return dict(zip(names, maps, strict=True))

    return run


@contextmanager
def quiet_exporter() -> Iterator[None]:
    """torch's exporter without its remarks on itself."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logging.disable(before)


NEEDS = ("onnx", "onnxscript", "onnxruntime")
"""The packages of the extra ``onnx``."""


@dataclass(frozen=True)
class Exported:
    """What was written: files, what they say about themselves, and how far they are off."""

    files: tuple[Path, ...]
    notes: Mapping[str, str]
    parity: Parity


def export_detector(detector: Detector, out: Path) -> Exported:
    """Write what can be exported of a detector as ONNX, once it says what Python says.

    Raises ConfigError for what cannot be exported, another suffix than .onnx, and a missing extra;
    InputError when the file would be more than ``BOUND`` off (then nothing is written), and when
    it cannot be written.
    """
    if out.suffix != ".onnx":
        problem = "does not end as ONNX files do"
        raise ConfigError(out, problem, f"name it {out.stem or 'road'}.onnx")
    if missing := [name for name in NEEDS if find_spec(name) is None]:
        problem = f"needs {', '.join(missing)}: not installed"
        raise ConfigError("export", problem, "pip install 'roadtorch[onnx]'")
    part = exportable(detector)
    make_folder(out.parent)
    notes = notes_of(detector, part)
    with TemporaryDirectory(prefix="roadtorch.") as folder:
        path = Path(folder) / out.name
        write_onnx(Graph(detector.analysis, part.steps, part.outputs), notes, path)
        run = open_onnx(path, torch.get_num_threads())
        apart = parity(run, part.steps, rendered_batches())
        if not apart.most <= BOUND:
            problem = f"would be {apart.most:.2g} off in its {apart.where}, more than {BOUND:g}"
            raise InputError(out, problem, "nothing was written; try other versions of the extra")
        with atomic(out) as temporary:
            shutil.copyfile(path, temporary)
    return Exported((out,), notes, apart)
