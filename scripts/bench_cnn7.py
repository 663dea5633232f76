"""Time CNN-7 at every pixel beside a large matrix product and ONNX Runtime, in one process.

    python scripts/bench_cnn7.py
    python scripts/bench_cnn7.py --sizes 960x720 --threads 1 --json cnn7.json

ONNX Runtime comes with the extra `onnx`; it runs the same network, exported, on as many threads.
Rounds as in ``bench.py``, but each timed call follows one of its own kind. Operations are those of
the network itself: what zeros, pixels past the border or the like add does not count.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import onnxruntime
import torch
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the rendered scenes

from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import RoadtorchError
from roadtorch.export.onnx_file import OPSET, quiet_exporter
from roadtorch.layout.normalisation import normalise
from roadtorch.layout.patch_network import PatchNetwork, Topology
from roadtorch.layout.weights import load_network, shipped_weights
from scripts.bench import (
    Round,
    machine,
    picture_at,
    positive,
    run_rounds,
    sizes,
    summary,
    table,
    time_call,
)

DENSE, DILATED = "every pixel", "every pixel, dilated, in torch"
RUNTIME, LARGE = "ONNX Runtime", "a large product"
DETECTOR = "layout:cnn-7 at 480x360"
NAMES = (DENSE, DILATED, RUNTIME, LARGE, DETECTOR)
RATIOS = {
    f"{RUNTIME} / {DENSE}": (RUNTIME, DENSE),
    f"{DILATED} / {DENSE}": (DILATED, DENSE),
}
SIDE = 1024
"""Of the square matrices of the large product."""


class Everywhere(nn.Module):
    """The network as a graph of pictures (1,3,H,W) → potentials (1,3,H,W)."""

    def __init__(self, network: PatchNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, pixels: Tensor) -> Tensor:
        return self.network.everywhere(pixels)


def runtime(network: PatchNetwork, pixels: Tensor, threads: int) -> Callable[[], Any]:
    """The network in ONNX Runtime, on pictures (3,H,W) of this one size."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors
    options.intra_op_num_threads = threads
    with tempfile.TemporaryDirectory() as folder, quiet_exporter(), torch.no_grad():
        path = Path(folder) / "network.onnx"
        program = torch.onnx.export(
            Everywhere(network), (pixels[None],), opset_version=OPSET, dynamo=True, verbose=False
        )
        assert program is not None
        program.save(str(path))
        session = onnxruntime.InferenceSession(path, options, ["CPUExecutionProvider"])
    given = {session.get_inputs()[0].name: pixels[None].numpy()}
    found = torch.from_numpy(session.run(None, given)[0])
    torch.testing.assert_close(found[0], network.dense(pixels), atol=1e-5, rtol=0)
    return partial(session.run, None, given)


def operations(shape: Topology) -> int:
    """Floating-point operations of the convolutions at one pixel, two for a multiplication."""
    planes = 3 if shape.input == "colour" else 1
    layers = ((planes, shape.k1, shape.size1), (shape.k1, shape.k2, shape.size2))
    return sum(
        2 * seen * kernels * side**2
        for seen, kernels, side in (*layers, (shape.k2, 3, shape.size3))
    )


@torch.inference_mode()
def twice(name: str, call: Callable[[], Any]) -> Round:
    """The second of two calls: caches are those of its own kind."""
    call()
    return time_call(name, call)


def contestants(image: Tensor, small: Tensor, threads: int) -> list[Callable[[], Round]]:
    """What is timed once a round."""
    network = load_network(shipped_weights("cnn-7"))
    assert isinstance(network, PatchNetwork)
    pixels = normalise(image, network.settings.normalisation).pixels
    square = torch.ones(SIDE, SIDE)
    calls = {
        DENSE: partial(network.dense, pixels),
        DILATED: partial(network.everywhere, pixels[None]),
        RUNTIME: runtime(network, pixels, threads),
        LARGE: lambda: square @ square,
        DETECTOR: partial(load_detector("layout:cnn-7").detect, small),
    }
    return [partial(twice, name, call) for name, call in calls.items()]


def shares(rounds: list[Round], pixels: int) -> dict[str, float]:
    """The medians of the share of the large product's rate that each reached in a round."""
    work = operations(Topology()) * pixels
    large = 2 * SIDE**3
    found = {}
    for name in (DENSE, DILATED, RUNTIME):
        reached = sorted(work / times[name] / (large / times[LARGE]) for times in rounds)
        found[name] = reached[len(reached) // 2]
    return found


def share_table(reached: dict[str, float]) -> str:
    lines = ["| share of the large product's rate | median |", "|---|---:|"]
    return "\n".join([*lines, *(f"| {name} | {share:.2f} |" for name, share in reached.items())])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--picture", type=Path, help="a street picture (default: a rendered one)")
    parser.add_argument("--sizes", type=sizes, default="960x720,320x240", help="width x height, …")
    parser.add_argument("--rounds", type=positive, default=20, help="counted rounds")
    parser.add_argument("--threads", type=positive, default=2)
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    results: dict[str, Any] = {"machine": machine(), "sizes": {}}
    print(", ".join(f"{name}: {value}" for name, value in results["machine"].items()))
    try:
        pictures = [picture_at(given.picture, *size) for size in given.sizes]
        small = picture_at(given.picture, 480, 360)
    except RoadtorchError as problem:
        parser.error(str(problem))
    for (width, height), image in zip(given.sizes, pictures, strict=True):
        size = f"{width}x{height}"
        rounds = run_rounds(contestants(image, small, given.threads), given.rounds, size)
        figures = summary(rounds, NAMES, RATIOS)
        reached = shares(rounds, width * height)
        results["sizes"][size] = figures | {"rounds": rounds, "shares": reached}
        print(f"\n{table(size, figures)}\n\n{share_table(reached)}", flush=True)
    if given.json:
        given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
