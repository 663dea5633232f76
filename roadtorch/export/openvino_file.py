"""OpenVINO files: an .xml with its .bin, made of the ONNX file."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from roadtorch.export.graph import EveryPixel, WholePictures
from roadtorch.export.onnx_file import write_onnx
from roadtorch.export.parity import Run

SECTION = "roadtorch"
"""Where the notes are in the rt_info of the model."""


def write_openvino(
    module: WholePictures | EveryPixel, notes: Mapping[str, str], path: Path
) -> None:
    """Write a module of ``graph`` as path (.xml) and weights beside it (.bin), in float32."""
    import openvino

    between = path.with_suffix(".onnx")
    write_onnx(module, {}, between)
    model = openvino.Core().read_model(between)
    for name, text in notes.items():
        model.set_rt_info(text, [SECTION, name])
    openvino.save_model(model, path, compress_to_fp16=False)
    between.unlink()


def open_openvino(path: Path, threads: int) -> Run:
    """What runs an OpenVINO or ONNX file on so many threads, by OpenVINO."""
    import openvino

    settings = {"INFERENCE_NUM_THREADS": threads, "INFERENCE_PRECISION_HINT": "f32"}
    model = openvino.Core().compile_model(path, "CPU", settings)
    names = [output.any_name for output in model.outputs]

    def run(pictures: np.ndarray) -> dict[str, np.ndarray]:
        found = model(np.ascontiguousarray(pictures))
        return {name: np.array(found[name]) for name in names}

    return run
