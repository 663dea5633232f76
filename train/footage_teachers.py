"""What teachers know of footage, each alone and pooled: F of their masks, and by how much.

    python train/footage_teachers.py FOOTAGE… [--second teacher.safetensors]

FOOTAGE holds images/ and masks/ (``train/footages.py``, ``python -m train.worlds --frames 60``).
A line a footage: F of `fusion`, then of each teacher the gain with its 95 % interval over
stretches of frames. look: `fusion:large`, the mean with its mirror image. time: the same
carried over time (``adapt.teacher``). drive: the look and the mean road of the other frames.
second: heads that worlds alone have taught (``train/second_teacher.py``); pooled: its mean with
the look, in log odds, carried over time. Labels score, nothing else.
"""

import argparse
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path

import torch
from torch import Tensor

from roadtorch import load_detector, read_image
from roadtorch.adapt.frames import STRETCH
from roadtorch.adapt.teacher import MOTION
from roadtorch.adapt.verdict import SEED
from roadtorch.data.catalogue import open_named
from roadtorch.evaluation.metrics import Decisions, count_mask, f_measure
from roadtorch.evaluation.uncertainty import bootstrap_weights, interval
from roadtorch.imaging.motion import flow_picture
from roadtorch.imaging.resize import resized
from roadtorch.layout.classes import CLASSES
from roadtorch.layout.weights import load_network
from roadtorch.road.fusion import log_odds
from roadtorch.road.steady import smoothed
from roadtorch.train.config import Teacher
from roadtorch.train.teachers import load_teachers, teacher_maps
from train.second_teacher import both_ways

SIZE = (240, 320)
PRIOR = 0.5
"""Weight of the log odds of the drive's mean road."""


def looks(second: Path | None) -> dict[str, Callable[[Tensor], Tensor]]:
    """Of an image (3,H,W), the likelihood (H,W) that each teacher gives by itself."""
    fusion, large = load_detector("fusion"), load_teachers(Teacher(detector="fusion:large"))
    found = {
        "fusion": lambda image: fusion.detect(image).likelihood,
        "look": lambda image: teacher_maps(image, large, "mirrored")[CLASSES],
    }
    if second:
        network = load_network(second).eval()
        found["second"] = lambda image: both_ways(network, image)["road"]  # type: ignore[arg-type]
    return found


def with_drive(odds: Tensor) -> Tensor:
    """Log odds (n,H,W) and those of the mean road of the other frames."""
    roads = odds.sigmoid()
    others = (roads.sum(0) - roads) / (len(roads) - 1)
    return odds + PRIOR * log_odds(others.clamp(0.03, 0.97))


def main() -> None:
    """A line a footage."""
    parser = argparse.ArgumentParser(description="What teachers know of footage.")
    parser.add_argument("footage", type=Path, nargs="+")
    parser.add_argument("--second", type=Path)
    given = parser.parse_args()
    teachers = looks(given.second)
    for footage in given.footage:
        dataset = open_named(f"folder:{footage}")
        images = [read_image(item.image) for item in dataset.items]
        truths = [dataset.truth(item) for item in dataset.items]
        odds = {
            name: torch.stack([log_odds(resized(look(one)[None], SIZE)[0]) for one in images])
            for name, look in teachers.items()
        }
        greys = [flow_picture(image, MOTION.width) for image in images]
        odds["time"] = torch.stack(smoothed(greys, list(odds["look"]), MOTION))
        odds["drive"] = with_drive(odds["look"])
        if given.second:
            both = list((odds["look"] + odds["second"]) / 2)
            odds["pooled"] = torch.stack(smoothed(greys, both, MOTION))
        road, valid = (
            torch.stack([resized(plane.float()[None], SIZE)[0] > 0.5 for plane in planes])
            for planes in ([one.road for one in truths], [one.valid for one in truths])
        )
        counts = {
            name: torch.stack(
                [
                    torch.stack(astuple(count_mask(*frame)))
                    for frame in zip(said > 0, road, valid, strict=True)
                ]
            )
            for name, said in odds.items()
        }
        print(footage.name, len(images), *lines(counts), sep=" | ", flush=True)


def lines(counts: dict[str, Tensor]) -> list[str]:
    """F of `fusion`, and the gain of each other one; counts (n,4) of each."""
    blocks = {
        name: torch.stack([part.sum(0) for part in each.split(STRETCH)]).double()
        for name, each in counts.items()
    }
    weights = bootstrap_weights(len(blocks["fusion"]), torch.Generator().manual_seed(SEED)).double()

    def f_of(counts: Tensor) -> Tensor:
        return f_measure(Decisions(*counts.unbind(-1)))

    base, drawn = f_of(blocks["fusion"].sum(0)), f_of(weights @ blocks["fusion"])
    told = [f"fusion {base:.3f}"]
    for name, each in blocks.items():
        if name != "fusion":
            change = interval(f_of(weights @ each) - drawn)
            gain = float(f_of(each.sum(0)) - base)
            told.append(f"{name} {gain:+.3f} ({change.low:+.3f} to {change.high:+.3f})")
    return told


if __name__ == "__main__":
    main()
