"""What ``bench.py`` measures of detectors, of their peers and of the networks."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import skimage
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from roadtorch.detectors.catalogue import list_detectors, load_detector
from roadtorch.export.exportable import exportable
from roadtorch.export.onnx_file import open_onnx, write_onnx
from roadtorch.imaging.color import REPRESENTATIONS
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import WeightsFile, network_of
from roadtorch.scenes.street import render_scene
from roadtorch.superpixels.slic import slic
from scripts.bench import Round, run_rounds, spread, time_call
from scripts.bench_figures import Figure, Parts, figure
from scripts.bench_oneclass import pairs
from scripts.torchvision_shim import torchvision

Calls = dict[str, Callable[[], Any]]
"""What is timed once a round, by the row that it has in the table."""

LRASPP = "LRASPP (torchvision)"
SEGMENTS = 400
OURS, THEIRS = "slic, 400 segments", "slic, 400 segments (scikit-image)"
SLOW = ("kmeans-road", "ufl", "ufl:kitti", "ufl:original", "vanishing-point")
"""Detectors of more than a tenth of a second: in a part of their own."""
GRID = ("oneclass:gaussian:RGB", "oneclass:nn:HS", "oneclass:svdd:S")
"""Of the grid of hundreds, the cheapest plane, two planes and three."""
SMALL = ("fusion", "layout:cnn-7", "ufl")
"""Of each paper one that has a network or a dictionary of its own."""
SIDE = 1024
"""Of the matrices whose product shows what rate the machine can reach."""


def street(width: int, height: int) -> Tensor:
    """The rendered street that everything is timed on, (3,H,W)."""
    return render_scene(0, height, width).image.contiguous()


def timed(calls: Calls, rounds: int, title: str) -> dict[str, list[float]]:
    """Milliseconds of each call in each round; a round runs all of them in turn."""
    contestants = [partial(time_call, name, call) for name, call in calls.items()]
    found: list[Round] = run_rounds(contestants, rounds, title)
    return {name: [times[name] for times in found] for name in calls}


def shown(part: str, row: str, column: str, values: Sequence[float], unit: str = "ms") -> Figure:
    """The figure of a series: its median, with the quartiles."""
    found = spread(list(values))
    ends = {key: float(f"{found[key]:.4g}") for key in ("low", "high")}
    return figure(part, row, column, found["median"], unit) | ends


def ratio(one: Sequence[float], other: Sequence[float]) -> list[float]:
    """The rounds' ratios."""
    return [a / b for a, b in zip(one, other, strict=True)]


def threads_in_words(threads: int) -> str:
    """``1 thread``, ``2 threads``."""
    return f"{threads} thread{'s' if threads > 1 else ''}"


def compared(part: str, calls: Calls, threads: int, rounds: int) -> list[Figure]:
    """Milliseconds of all calls, and their shares of LRASPP's, which is one of them."""
    words = threads_in_words(threads)
    times = timed(calls, rounds, f"{part}, {words}")
    return [
        one
        for name, values in times.items()
        for one in (
            shown(part, name, f"ms, {words}", values),
            shown(part, name, f"of LRASPP, {words}", ratio(values, times[LRASPP]), ""),
        )
    ]


def lraspp(image: Tensor) -> Callable[[], Any]:
    """torchvision's small network for segmentation on this image, with random weights."""
    torch.manual_seed(0)
    network = torchvision.models.segmentation.lraspp_mobilenet_v3_large(
        weights=None, weights_backbone=None
    ).eval()

    @torch.inference_mode()
    def run() -> Any:
        return network(image[None])

    return run


def quick_detectors() -> list[str]:
    """All but the slow ones and the grid."""
    return [name for name in list_detectors() if "<" not in name and name not in SLOW]


def detects(names: Sequence[str], image: Tensor) -> Calls:
    """``detect`` of detectors, by their names."""
    return {name: partial(load_detector(name).detect, image) for name in names}


def superpixels(image: Tensor) -> Calls:
    """Ours and scikit-image's."""
    rows = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
    theirs = partial(skimage.segmentation.slic, rows, SEGMENTS, compactness=10)
    return {OURS: partial(slic, image, SEGMENTS), THEIRS: theirs}


def measure_detectors(threads: int, rounds: int) -> list[Figure]:
    """Every detector but the slow ones and the grid, beside LRASPP and scikit-image's slic."""
    image = street(640, 480)
    calls = detects(quick_detectors(), image) | {LRASPP: lraspp(image)} | superpixels(image)
    return compared("detectors", calls, threads, rounds)


def measure_slow(threads: int, rounds: int) -> list[Figure]:
    """The detectors of more than a tenth of a second."""
    image = street(640, 480)
    calls = detects([*SLOW, *GRID], image) | {LRASPP: lraspp(image)}
    return compared("slow-detectors", calls, threads, rounds)


def measure_large(threads: int, rounds: int) -> list[Figure]:
    """``fusion`` and its peers on a picture of 960×720."""
    image = street(960, 720)
    calls = detects(["fusion"], image) | {LRASPP: lraspp(image)} | superpixels(image)
    return compared("large", calls, threads, rounds)


def measure_small(threads: int, rounds: int) -> list[Figure]:
    """Detectors of the three papers on a picture of 480×360, and how many they look at a second."""
    words = threads_in_words(threads)
    calls = detects(SMALL, street(480, 360))
    return [
        one
        for name, values in timed(calls, rounds, f"small, {words}").items()
        for one in (
            shown("small", name, f"ms, {words}", values),
            shown("small", name, f"pictures/s, {words}", [1000 / ms for ms in values], "/s"),
        )
    ]


# --- networks ---------------------------------------------------------------------------


def operations_of(call: Callable[[], Any]) -> int:
    """Floating-point operations of the products and convolutions in a call."""
    with FlopCounterMode(display=False) as counter:
        call()
    return counter.get_total_flops()


def network_calls(name: str, image: Tensor, threads: int, folder: Path, **settings: Any) -> Calls:
    """A detector's network with what is before and behind it: in torch, and in ONNX Runtime."""
    part = exportable(load_detector(name, **settings))
    file = folder / f"{name.replace(':', '-')}.onnx"
    write_onnx(part.module, {}, file)
    run, picture = open_onnx(file, threads), (image.permute(1, 2, 0)[None] * 255).byte()

    @torch.inference_mode()
    def here() -> Any:
        return part.module(picture)

    return {
        f"network of {name}": here,
        f"network of {name} (ONNX Runtime)": partial(run, picture.numpy()),
    }


def measure_networks(threads: int, rounds: int) -> list[Figure]:
    """The networks, the same in ONNX Runtime, and the product of two 1024² matrices."""
    words, square = threads_in_words(threads), torch.rand(SIDE, SIDE)
    part, image = "networks", street(960, 720)
    with TemporaryDirectory() as folder:
        calls = network_calls("layout", image, threads, Path(folder))
        working = {"pixels": image[0].numel()}
        calls |= network_calls("layout:cnn-7", image, threads, Path(folder), working=working)
        dense = network_of(WeightsFile(), "cnn-7", PatchNetwork).dense
        calls |= {"dense of layout:cnn-7 alone": partial(dense, image)}
        product = f"product of {SIDE}² matrices"
        calls |= {product: partial(torch.mm, square, square)}
        work = {name: operations_of(call) for name, call in calls.items() if "(" not in name}
        times = timed(calls, rounds, f"{part}, {words}")
    best = work[product] / median(times[product])
    found = []
    for name, values in times.items():
        count = work[name.removesuffix(" (ONNX Runtime)")]
        rate = count / median(values)
        found += [
            figure(part, name, "GFLOP", count / 1e9, "GFLOP"),
            shown(part, name, f"ms, {words}", values),
            figure(part, name, f"GFLOP/s, {words}", rate / 1e6, "GFLOP/s"),
            figure(part, name, f"of the product's rate, {words}", rate / best),
        ]
    return found


def measure_gaussian(threads: int, rounds: int) -> list[Figure]:
    """The one-class Gaussian beside scikit-learn's, in every representation of colour."""
    words, image = threads_in_words(threads), street(640, 480)
    found = []
    for representation in REPRESENTATIONS:
        both = pairs(image, representation)
        calls = {side: both["gaussian", side] for side in ("ours", "theirs")}
        times = timed(calls, rounds, f"gaussian, {representation}")
        found += [
            shown("gaussian", representation, f"ms, {words}", times["ours"]),
            shown("gaussian", representation, f"scikit-learn, ms, {words}", times["theirs"]),
            shown(
                *("gaussian", representation, f"times as fast, {words}"),
                ratio(times["theirs"], times["ours"]),
                "",
            ),
        ]
    return found


PARTS: Parts = {
    "detectors": measure_detectors,
    "large": measure_large,
    "small": measure_small,
    "slow-detectors": measure_slow,
    "networks": measure_networks,
    "gaussian": measure_gaussian,
}
