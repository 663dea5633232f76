"""Time detectors beside their peers: LRASPP of torchvision, and superpixels of scikit-image.

    python scripts/bench.py                                      # every detector, one thread
    python scripts/bench.py fusion ufl --size 960x720
    python scripts/bench.py --write                              # and keep what documents show

Each round runs every contestant once, in an order that moves on by one from round to round. Times
are medians over the rounds; a ratio is the median of the rounds' ratios: what slows the whole
machine for a while slows both sides of it. Other work on the same cores does not; measure on a
quiet machine. ``--write`` keeps the figures in docs/figures/bench.json.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.benchmark import Timer

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch.detectors.catalogue import list_detectors, load_detector
from roadtorch.scenes.street import render_scene
from roadtorch.superpixels.slic import slic
from scripts.readme_tables import TIMED

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "docs" / "figures" / "bench.json"
COMMAND = "python scripts/bench.py --write"
LRASPP = "LRASPP (torchvision)"
SEGMENTS = 400
SLIC, SKIMAGE = f"slic, {SEGMENTS} segments", f"slic, {SEGMENTS} segments (scikit-image)"
PEERS = {LRASPP: "LRASPP", SLIC: "slic", SKIMAGE: "slic-skimage"}
"""Peers, and the names of their records."""
WARM_UP = 2  # rounds that are not counted

Calls = Mapping[str, Callable[[], Any]]
"""What is timed once a round, by name."""
Times = dict[str, list[float]]
"""Milliseconds by name, a number a round."""


def interleaved(calls: Calls, rounds: int) -> Times:
    """Milliseconds of every call in every counted round, on one thread of torch."""
    timers = {name: Timer("call()", globals={"call": call}) for name, call in calls.items()}
    times: Times = {name: [] for name in calls}
    for number in range(WARM_UP + rounds):
        turn = number % len(timers)
        for name in [*list(timers)[turn:], *list(timers)[:turn]]:
            taken = timers[name].timeit(1).mean * 1000
            if number >= WARM_UP:
                times[name].append(taken)
    return times


def ratio(one: Sequence[float], other: Sequence[float]) -> float:
    """The median of the rounds' ratios."""
    return median(a / b for a, b in zip(one, other, strict=True))


def lraspp(image: Tensor) -> Callable[[], Any]:
    """torchvision's small network for segmentation on this image, with random weights."""
    from roadtorch.runtime.vision import import_torchvision

    torch.manual_seed(0)
    segmentation = import_torchvision().models.segmentation
    network = segmentation.lraspp_mobilenet_v3_large(weights=None, weights_backbone=None).eval()

    @torch.inference_mode()
    def run() -> Any:
        return network(image[None])

    return run


def contestants(names: Sequence[str], image: Tensor) -> Calls:
    """``detect`` of the named detectors, and the peers."""
    import skimage.segmentation

    rows = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
    theirs = partial(skimage.segmentation.slic, rows, SEGMENTS, compactness=10)
    return {
        **{name: partial(load_detector(name).detect, image) for name in names},
        LRASPP: lraspp(image),
        SLIC: partial(slic, image, SEGMENTS),
        SKIMAGE: theirs,
    }


def table(times: Times) -> str:
    """Markdown: a row a contestant."""
    lines = ["| one thread | ms | of LRASPP |", "|---|---:|---:|"]
    for name, values in times.items():
        lines.append(f"| {name} | {median(values):.1f} | {ratio(values, times[LRASPP]):.2f} |")
    return "\n".join(lines)


def keep(times: Times) -> None:
    """Write the figures where documents find them (scripts/readme_figures.py)."""
    values: dict[str, float] = {}
    for name in set(times) & {*TIMED, *PEERS}:
        taken = times[name]
        values[f"bench.{PEERS.get(name, name)}.ms"] = median(taken)
        values[f"bench.{PEERS.get(name, name)}.of_lraspp"] = ratio(taken, times[LRASPP])
    text = json.dumps(
        {"command": COMMAND, "values": {key: values[key] for key in sorted(values)}}, indent=0
    )
    KEPT.write_text(f"{text}\n", encoding="utf-8")


def size(text: str) -> tuple[int, int]:
    """``640x480`` → (640, 480): width and height, each at least 16."""
    parts = [int(part) for part in text.split("x") if part.isdecimal()]
    if len(parts) != 2 or min(parts) < 16:
        raise argparse.ArgumentTypeError(f"{text}: give a size from 16x16 up, such as 640x480")
    return parts[0], parts[1]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("detectors", nargs="*", help="all but the grid of one-class detectors")
    parser.add_argument("--size", type=size, default=(640, 480), help="of the rendered street")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--write", action="store_true", help="into docs/figures/bench.json")
    given = parser.parse_args()
    names = given.detectors or [name for name in list_detectors() if "<" not in name]
    width, height = given.size
    image = render_scene(0, height, width).image.contiguous()
    times = interleaved(contestants(names, image), given.rounds)
    print(table(times))
    if given.write:
        keep(times)


if __name__ == "__main__":
    main()
