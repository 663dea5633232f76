"""ONNX files: written by torch's exporter, run by ONNX Runtime."""

import logging
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.base.version import __version__

OPSET = 18

Steps = Callable[[Tensor], Mapping[str, Tensor]]
"""An image (3,H,W) in [0,1] → maps by name, of any of which a graph may be traced."""

Run = Callable[[np.ndarray], Mapping[str, np.ndarray]]
"""Pictures uint8 (N,H,W,3) RGB → maps by name, by a runtime that has read a file."""

EXAMPLE = (2, 240, 320, 3)
"""The shape of the pictures that the graph is traced with; no number of it stays but the 3."""


class Graph(nn.Module):
    """Steps as a module of the exporter: pictures uint8 (N,H,W,3) RGB → the outputs, in order.

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

    def run(pictures: np.ndarray) -> dict[str, np.ndarray]:
        maps: list[Any] = list(session.run(names, {"image": pictures}))
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
