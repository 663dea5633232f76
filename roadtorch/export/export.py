"""Export of detectors as ONNX files that run without Python."""

import math
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.base.atomic import atomic_write, file_digest, make_folder
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import from_pixels, to_pixels
from roadtorch.base.progress import Progress
from roadtorch.base.twins import use_twins
from roadtorch.base.version import __version__
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.detector import MIN_IMAGE_SIDE, Detector
from roadtorch.detectors.fusion import Fusion, FusionSettings
from roadtorch.detectors.layout import Cnn7, Cnn7Settings
from roadtorch.export.steps import TWINS
from roadtorch.imaging.resize import resize_maps, resize_to_image, resize_to_work, spatial_size
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.runtimes import (
    MAX_DIFFERENCE,
    REFERENCE,
    TRACING_PACKAGES,
    ExportGraph,
    GraphFunction,
    MapFunction,
    open_onnxruntime,
    require_packages,
    trace_onnx,
)
from roadtorch.layout.weights import DEFAULT_WEIGHTS, read_terms, weights_path
from roadtorch.road.outlines import snap_to_edges
from roadtorch.testing.scenes import render_scene

# --- exportable parts --------------------------------------------------------------------

EXPORTABLE_DETECTORS = ("fusion", "layout:cnn-7")

ISOLATED_ROAD_STEP = "removal of isolated road"

UNKNOWN_TERMS = "those of the author of the weights"

OUTPUT_DESCRIPTIONS: Mapping[str, str] = {
    "likelihood": "float32 (N, H, W): likelihood of road, 0 to 1",
    "layout": "float32 (N, 3, H, W): sky, vertical, horizontal, 0 to 1",
    "ego": "float32 (N, H, W): vehicle that carries the camera, 0 or 1",
    "seed_area": "float32 (N, H, W): road that isolated road does not touch, 0 or 1",
    "trust": "float32 (N): predicted F-score of the mask, 0 to 1",
    "mask": "uint8 (N, H, W): 1 road, 0 not",
}
"""Outputs of the files, by name."""

UNUSED_SETTINGS = ("isolated", "ego", "rectification", "outlines", "trust")


@dataclass(frozen=True)
class ExportPart:
    """Part of a detector as a function that can be traced.

    description: the part, in words. missing: steps that only Python does. compute: maps an image
    (3, H, W) in [0, 1], while traced a batch (N, 3, H, W), to the outputs by name. outputs: keys
    of ``OUTPUT_DESCRIPTIONS``. unused: keys of settings. weights: its file.
    """

    description: str
    missing: str
    compute: MapFunction
    outputs: tuple[str, ...]
    unused: tuple[str, ...]
    weights: Path


def exportable_part(detector: Detector) -> ExportPart:
    """Return the part of a detector that can be exported.

    Raises ConfigError for a detector that has none, and for settings that it does not use.
    """
    part = find_part(detector)
    defaults = detector_entry(detector.name).make_settings({}).model_dump()
    for key, value in detector.settings.model_dump().items():
        if key in part.unused and value != defaults[key]:
            raise ConfigError(key, "has no effect on the exported file", "leave it out")
    if detector.runtime != REFERENCE:
        raise ConfigError("runtime", "has no effect on the exported file", "leave it out")
    return part


def find_part(detector: Detector) -> ExportPart:
    """Return the part of a detector whatever its settings; raise ConfigError where it has none."""
    analysis, settings = detector.analysis, detector.settings
    if isinstance(analysis, Fusion) and isinstance(settings, FusionSettings):
        part = ExportPart(
            "likelihood, layout, ego car and trust",
            f"filling of thin holes, {ISOLATED_ROAD_STEP}",
            partial(fusion_maps, analysis, settings),
            ("likelihood", "layout", "ego", "seed_area", "trust"),
            UNUSED_SETTINGS,
            weights_path(settings.weights.file or DEFAULT_WEIGHTS),
        )
    elif isinstance(analysis, Cnn7) and isinstance(settings, Cnn7Settings):
        part = ExportPart(
            "likelihood and layout",
            ISOLATED_ROAD_STEP,
            partial(cnn7_maps, analysis, settings),
            ("likelihood", "layout"),
            (*UNUSED_SETTINGS, "seed_area"),
            weights_path(settings.weights.file or "cnn-7"),
        )
    else:
        hint = f"can be exported: {', '.join(EXPORTABLE_DETECTORS)}"
        raise ConfigError(detector.name, "cannot be exported", hint)
    return part


def fusion_maps(analysis: Fusion, settings: FusionSettings, image: Tensor) -> dict[str, Tensor]:
    """Compute all outputs of `fusion` but the steps on connected regions.

    Thin holes are not filled, and isolated road is not removed. The likelihood is refined at the
    image's full size, however large.
    """
    small, full = resize_to_work(image, settings.working), spatial_size(image)
    cues = analysis(small)
    likelihood = snap_to_edges(cues, small, image, settings.threshold)
    ego = resize_to_image(cues["ego"], full)
    likelihood = likelihood.masked_fill(ego, 0)
    mask = resize_to_image(likelihood >= settings.threshold, spatial_size(small))
    return {
        "likelihood": likelihood,
        "layout": resize_maps(cues["layout"], full),
        "ego": ego.float(),
        "seed_area": resize_to_image(cues["seed_area"], full).float(),
        "trust": torch.as_tensor(analysis.judge(mask, cues).trust),
    }


def cnn7_maps(analysis: Cnn7, settings: Cnn7Settings, image: Tensor) -> dict[str, Tensor]:
    """Compute all outputs of `layout:cnn-7` but the removal of isolated road."""
    layout = analysis.network.potentials(resize_to_work(image, settings.working))
    layout = resize_maps(layout, spatial_size(image))
    return {"likelihood": layout[..., HORIZONTAL, :, :], "layout": layout}


def mask_part(part: ExportPart, threshold: float) -> ExportPart:
    """Return a part whose maps are the mask alone: a quarter of the likelihood's bytes."""

    def compute(image: Tensor) -> dict[str, Tensor]:
        maps = part.compute(image)
        return {**maps, "mask": (maps["likelihood"] >= threshold).to(torch.uint8)}

    outputs = ("mask", "trust") if "trust" in part.outputs else ("mask",)
    description = " and ".join(outputs)
    return replace(part, description=description, compute=compute, outputs=outputs)


def describe_export(detector: Detector, part: ExportPart) -> dict[str, str]:
    """Return the metadata of the file, by name."""
    return {
        "roadtorch": __version__,
        "detector": detector.name,
        "part": part.description,
        "lacks": part.missing,
        "input": "image: uint8 (N, H, W, 3)",
        "colour_order": "RGB",
        "range": "0 to 255",
        "smallest_side": str(MIN_IMAGE_SIDE),
        **{f"output.{name}": OUTPUT_DESCRIPTIONS[name] for name in part.outputs},
        "threshold": f"{detector.settings.threshold:g}",
        "weights": part.weights.name,
        "weights_sha256": file_digest(part.weights),
        "terms": f"{describe_terms(part.weights)}; the code is Apache-2.0",
    }


def describe_terms(weights: Path) -> str:
    """Return the terms of use of weights, and the card that states them."""
    stated = read_terms(weights)
    return f"{stated} (see {weights.stem}.md beside the weights)" if stated else UNKNOWN_TERMS


# --- parity with Python ------------------------------------------------------------------

PARITY_SIZES = ((48, 64), (121, 317), (360, 480))
"""Height and width of the rendered images for the check: below the size of the network, above it,
and above the working size of detectors."""


MAX_FLIPPED = 1e-5  # fraction of pixels that may differ, at least one: at a threshold of a step


@dataclass(frozen=True)
class Parity:
    """Largest and mean difference of a file's results to Python's, over all pixels.

    The largest is that of all but ``MAX_FLIPPED``; that of masks the fraction of an image's pixels
    that differ. location: output and image size of the largest. images: number of images checked.
    """

    max_difference: float
    location: str
    mean_difference: float
    images: int


def render_batches() -> Iterator[np.ndarray]:
    """Yield images uint8 (2, H, W, 3) RGB, by day and at dusk, of each of ``PARITY_SIZES``."""
    for seed, (height, width) in enumerate(PARITY_SIZES):
        scenes = (render_scene(seed, height, width, dusk=dusk) for dusk in (0.0, 0.9))
        yield np.stack([to_pixels(scene.image) for scene in scenes])


def measure_parity(
    run: GraphFunction, compute: MapFunction, batches: Iterable[np.ndarray]
) -> Parity:
    """Compare ``run`` with the computation in Python on batches of images uint8 (N, H, W, 3).

    NaN counts as an infinite difference.
    """
    images, pixels, total = 0, 0, 0.0
    extremes: list[tuple[float, str]] = []
    for batch in batches:
        maps = run(batch)
        for index, image in enumerate(batch):
            expected = compute(from_pixels(image))
            height, width = image.shape[:2]
            images += 1
            for name, values in maps.items():
                actual = torch.as_tensor(values[index])
                difference = (actual.float() - expected[name].float()).abs().nan_to_num(torch.inf)
                if actual.dtype == torch.uint8:
                    difference = difference.mean()
                count = difference.numel()
                flipped = min(math.ceil(MAX_FLIPPED * count), count - 1)
                largest = difference.flatten().topk(1 + flipped).values[-1]
                extremes.append((float(largest), f"{name} at {width}×{height}"))
                pixels += difference.numel()
                total += float(difference.double().sum())
    return Parity(*max(extremes), total / pixels, images)


# --- ONNX --------------------------------------------------------------------------------

EXAMPLE_SHAPE = (2, 240, 320, 3)
"""Shape of the images that the graph is traced with; all but the 3 are dynamic."""


def write_onnx(
    analysis: nn.Module, part: ExportPart, metadata: Mapping[str, str], path: Path
) -> None:
    """Write a graph from images uint8 (N, H, W, 3) RGB to the outputs; needs onnx and onnxscript.

    The same part, metadata and versions of packages give the same bytes on every machine.
    """

    def compute(image: Tensor) -> Mapping[str, Tensor]:
        return part.compute(image.permute(0, 3, 1, 2).to(torch.float32) / 255)

    graph, sizes = ExportGraph(analysis, compute, part.outputs), {0: "N", 1: "H", 2: "W"}
    example = torch.zeros(EXAMPLE_SHAPE, dtype=torch.uint8)
    with use_twins(TWINS):
        program = trace_onnx(graph, example, "image", sizes)
    program.model.producer_name, program.model.producer_version = "roadtorch", __version__
    program.model.metadata_props.update(metadata)
    for node in program.model.graph.all_nodes():
        node.metadata_props.clear()  # paths of source files on this machine
    program.save(str(path))


@dataclass(frozen=True)
class ExportResult:
    """Files that were written, their metadata, and their differences to Python."""

    files: tuple[Path, ...]
    metadata: Mapping[str, str]
    parity: Parity


def export_detector(
    detector: Detector, out: Path, content: Literal["maps", "mask"] = "maps"
) -> ExportResult:
    """Write the exportable part of a detector as ONNX, after a check against Python.

    content: all maps, or the mask alone with its trust.

    Raises ConfigError for a detector that cannot be exported, another suffix than .onnx, and a
    missing extra; InputError when the file would differ by more than ``MAX_DIFFERENCE``, and when
    it cannot be written.
    """
    if out.suffix != ".onnx":
        raise ConfigError(out, "does not end in .onnx", f"name it {out.stem or 'road'}.onnx")
    require_packages("export", "onnx", *TRACING_PACKAGES, "onnxruntime")
    part = exportable_part(detector)
    if content == "mask":
        part = mask_part(part, detector.settings.threshold)
    make_folder(out.parent)
    metadata = describe_export(detector, part)
    bar = Progress(total=2, unit="step", desc=f"export of {detector.name}")
    with TemporaryDirectory(prefix="roadtorch.") as folder, bar:
        path = Path(folder) / out.name
        write_onnx(detector.analysis, part, metadata, path)
        bar.update()
        run = open_onnxruntime(path, torch.get_num_threads())
        parity = measure_parity(run, part.compute, render_batches())
        bar.update()
        if not parity.max_difference <= MAX_DIFFERENCE:
            difference = f"{parity.max_difference:.2g} in {parity.location}"
            problem = f"would differ by {difference}, more than {MAX_DIFFERENCE:g}"
            raise InputError(out, problem, "nothing was written; try other versions of packages")
        with atomic_write(out) as temporary:
            shutil.copyfile(path, temporary)
    return ExportResult((out,), metadata, parity)
