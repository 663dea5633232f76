"""Runtimes: torch, the reference, or ONNX Runtime, which computes a network's graph on the CPU.

It takes two thirds of torch's time for the same network. The graph, of one image of the network's
size, is kept in the user's cache folder, since tracing takes seconds.
"""

import hashlib
import logging
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.base.atomic import atomic_write, make_folder
from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import ConfigError, InputError, unknown_name_error
from roadtorch.base.version import __version__
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.network_cues import scores_to_potentials
from roadtorch.layout.weights import hash_tensors

REFERENCE = "torch"

TRACING_PACKAGES = ("onnx", "onnxscript")

RUNTIMES = (REFERENCE, "onnxruntime")
"""A runtime is named like its package."""

OPSET = 18

MAX_DIFFERENCE = 1e-4
"""Largest difference to Python allowed. Ours: a fortieth of the step between two grey levels."""

GraphFunction = Callable[[np.ndarray], Mapping[str, np.ndarray]]
"""The input of a graph → its outputs by name, by a runtime that has compiled it."""


def check_runtime(runtime: str, device: str | None = None) -> None:
    """Raise ConfigError for an unknown runtime, a missing extra, or a device but the CPU."""
    if runtime not in RUNTIMES:
        raise unknown_name_error("runtime", str(runtime), RUNTIMES)
    if runtime != REFERENCE:
        require_packages(runtime, "onnx", *TRACING_PACKAGES, runtime)
        if device not in (None, "cpu"):
            raise ConfigError(device, f"{runtime} computes on the CPU", "leave one of them out")


def require_packages(where: str, extra: str, *packages: str) -> None:
    """Raise ConfigError where packages of an extra are missing."""
    if missing := [name for name in packages if find_spec(name) is None]:
        problem = f"needs {', '.join(missing)}: not installed"
        raise ConfigError(where, problem, f"pip install 'roadtorch[{extra}]'")


# --- networks of a detector -----------------------------------------------------------------


@torch.no_grad()
def use_runtime(name: str, analysis: nn.Module, runtime: str) -> None:
    """Let a runtime compute the whole-image networks of an analysis; their weights are fixed.

    Raises ConfigError for an analysis without any (``name`` is its detector's), and where a network
    cannot be compiled or its potentials differ from torch's by more than ``MAX_DIFFERENCE``.
    """
    if runtime == REFERENCE:
        return
    networks = [part for part in analysis.modules() if isinstance(part, BackboneNetwork)]
    if not networks:
        problem = f"has no whole-image network for {runtime}"
        raise ConfigError(name, problem, "leave the runtime out, or use fusion")
    for network in networks:
        shape = (1, 3, network.settings.height, network.settings.width)
        pixels = torch.rand(shape, generator=torch.Generator().manual_seed(0))
        try:
            encoder = CompiledEncoder(network_graph(network, pixels))
            maps = [scores_to_potentials(encode(pixels)[0]) for encode in (encoder, network.encode)]
            difference = float((maps[0] - maps[1]).abs().max())
            if not difference <= MAX_DIFFERENCE:  # also true of NaN
                raise ArithmeticError(f"it would differ from torch by {difference:.2g}")
        except Exception as error:  # the packages of a runtime raise anything
            problem = f"cannot compile the network: {reason(error)}"
            raise ConfigError(runtime, problem, "use torch, or another version of it") from None
        network.encode = encoder  # pyright: ignore[reportAttributeAccessIssue]


class CompiledEncoder:
    """``encode`` of a network by ONNX Runtime: pixels (1, 3, H, W) → scores and features.

    Every process compiles the graph for itself: the library does not survive a fork or pickling.
    What a process inherited is kept, as freeing it would wait for threads that do not exist.
    """

    def __init__(self, graph: bytes) -> None:
        self.graph = graph
        self._functions: dict[int, GraphFunction] = {}  # by process

    def __call__(self, pixels: Tensor) -> tuple[Tensor, Tensor]:
        """Return scores and features, without gradients."""
        process = os.getpid()
        if process not in self._functions:
            self._functions[process] = open_onnxruntime(self.graph, 1)
        values = self._functions[process](pixels.detach().float().contiguous().numpy())
        scores, features = (torch.from_numpy(values[name]) for name in ENCODER_OUTPUTS)
        return scores, features

    def __reduce__(self) -> tuple[type["CompiledEncoder"], tuple[bytes]]:
        """Pickle and copy the graph alone."""
        return CompiledEncoder, (self.graph,)


# --- graphs ---------------------------------------------------------------------------------


ENCODER_OUTPUTS = ("scores", "features")


MapFunction = Callable[[Tensor], Mapping[str, Tensor]]
"""An image (3, H, W) in [0, 1], or other input → maps by name; can be traced."""


class ExportGraph(nn.Module):
    """Module for the exporter: a function's input → its outputs, in order.

    owner: the module that holds the weights.
    """

    def __init__(self, owner: nn.Module, compute: MapFunction, outputs: Sequence[str]) -> None:
        super().__init__()
        self.owner, self.compute, self.outputs = owner, compute, outputs

    def forward(self, values: Tensor) -> tuple[Tensor, ...]:
        """Return the outputs."""
        maps = self.compute(values)
        return tuple(maps[name] for name in self.outputs)


def network_graph(network: BackboneNetwork, pixels: Tensor) -> bytes:
    """Return the graph of a network for pixels of one shape, from the cache if it is there.

    A cached file is the graph's SHA-256 and the graph, and is used where they agree. Where it
    cannot be written, nothing is kept.
    """
    parts = (__version__, torch.__version__, network.kind, network.settings, pixels.shape)
    key = hashlib.sha256(f"{parts} {hash_tensors(network.state_dict())}".encode()).hexdigest()
    folder = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    path = Path(os.path.expanduser(folder), "roadtorch", f"network-{key[:32]}.onnx")
    with suppress(InputError, OSError):
        data = read_regular(path)
        if data[:32] == hashlib.sha256(data[32:]).digest():
            return data[32:]

    def encode(pixels: Tensor) -> Mapping[str, Tensor]:
        return dict(zip(ENCODER_OUTPUTS, network.encode(pixels), strict=True))

    module = ExportGraph(network, encode, ENCODER_OUTPUTS)
    graph = trace_onnx(module, pixels, "pixels").model_proto.SerializeToString()
    with suppress(InputError):
        make_folder(path.parent)
        with atomic_write(path) as temporary:
            temporary.write_bytes(hashlib.sha256(graph).digest() + graph)
    return graph


def trace_onnx(
    module: ExportGraph, example: Tensor, name: str, sizes: dict[int, str] | None = None
) -> torch.onnx.ONNXProgram:
    """Trace a module as an ONNX graph; needs ``TRACING_PACKAGES``.

    name: of the input. sizes: names of its dimensions that are free.
    """
    with silence_exporter(), torch.no_grad():
        program = torch.onnx.export(
            module.eval(),
            (example,),
            input_names=[name],
            output_names=list(module.outputs),
            dynamic_shapes=(sizes,) if sizes else None,
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    return program


@contextmanager
def silence_exporter() -> Iterator[None]:
    """Suppress the log messages and warnings of torch's exporter."""
    disabled = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logging.disable(disabled)


def open_onnxruntime(graph: bytes | Path, threads: int) -> GraphFunction:
    """Return a graph's function by ONNX Runtime on the CPU."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors
    options.intra_op_num_threads = options.inter_op_num_threads = threads
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    name, outputs = session.get_inputs()[0].name, [item.name for item in session.get_outputs()]

    def run(values: np.ndarray) -> dict[str, np.ndarray]:
        maps: list[Any] = list(session.run(outputs, {name: values}))
        return dict(zip(outputs, maps, strict=True))

    return run
