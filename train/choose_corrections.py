"""Settings of learning from corrections, tried on pictures that no table reports.

    python train/choose_corrections.py ../shared/data --curves 0001TP --count 20
    python train/choose_corrections.py ../shared/data --curves 0001TP --count 20 \\
        --set corrections.share=0.5
    python train/choose_corrections.py ../shared/data --curves idd-pool --count 20 \\
        --set random_seed=1

Trains once a curve, and says how good ``fusion`` is with these weights when the network's road
has one weight or another in it (``learned.detail``), and 0.5 is set by machine labels and the
picture's own threshold (``calibration`` as it ships) or by nothing; and how far from an outline of
the road the pixels lie that stay wrong. The seed draws the pictures too. The curves: 0001TP, the
other part 10 s away; the pool of IDD (``study_corrections.py``) parted again; folders of many/.
"""

import argparse
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from roadtorch.annotate.next_pictures import RULES
from roadtorch.data.catalogue import open_dataset
from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.scoring import read_scene
from roadtorch.settings import merge, parse_assignments, read_settings_file
from roadtorch.train.config import build_training
from train.study_corrections import (
    CONFIG,
    Curve,
    Study,
    corrected,
    curves,
    drive_curve,
    folder_curve,
    score,
)

NEAR = 10.0  # seconds between the two parts of 0001TP
FOLDERS = ("dn_bdd_drivable", "cityscapes", "dn_cassed", "dn_tas500")
REACHES = (2, 5, 10)  # pixels from an outline
DETAILS = (0.5, 1.0, 2.0, 3.0)
CENTRES: tuple[dict[str, float], ...] = ({}, {"centre": 0.0, "own": 0.0})


class Tried(NamedTuple):
    """One way to trust a network, and what it is worth on a curve's test."""

    detail: float
    calibration: dict[str, float]
    maxf: float
    f: float


def choosing_curves(data: Path) -> Iterator[Curve]:
    """Curves for choosing: none of their test pictures is one of a reported test."""
    idd = next(curves(data))
    parts = [[item for i, item in enumerate(idd.pool) if (i % 5 < 3) == here] for here in (1, 0)]
    yield Curve("idd-pool", idd.dataset, *parts)
    yield drive_curve(open_dataset("camvid", data / "camvid", "train"), "0001TP", NEAR)
    many = open_dataset("folder", data / "many")
    for folder in FOLDERS:
        yield folder_curve(many, folder)


def learned(study: Study, curve: Curve, count: int) -> dict[str, Any]:
    """Settings of ``fusion`` after so many random pictures, drawn by the training's seed."""
    training = build_training(study.values)
    places = RULES["random"](study.candidates(curve), [], count, training.random_seed)
    people = [corrected(curve.dataset, curve.pool[place]) for place in places]
    return study.trained(curve, people, training)


def tried(weights: dict[str, Any], curve: Curve) -> list[Tried]:
    """The scores of every way to trust what was learned."""
    found = []
    for detail, calibration in product(DETAILS, CENTRES):
        own: dict[str, Any] = {"learned": {"detail": detail}, "calibration": calibration}
        told = score(load_detector("fusion", weights=weights, **own), curve)
        found.append(Tried(detail, calibration, told["maxf"], told["f"]))
    return found


def wrong_pixels(detector: Detector, curve: Curve) -> Tensor:
    """Wrong pixels by the distance to the nearest outline of the road, int64 (2,bands).

    Rows: not road that was called road, road that was missed. Bands: up to each of ``REACHES``
    pixels, and farther.
    """
    found = torch.zeros(2, len(REACHES) + 1, dtype=torch.int64)
    for item in curve.test:
        scene = read_scene(curve.dataset, item)
        road, valid = scene.truth.road, scene.truth.valid
        mask = detector.detect(scene.image).mask
        band = sum((~at_outline(road, reach)).to(torch.int64) for reach in REACHES)
        for row_of, wrong in zip(found, (mask & ~road & valid, ~mask & road & valid), strict=True):
            row_of += torch.bincount(band[wrong], minlength=len(row_of))  # type: ignore[index]
    return found


def told_wrong(wrong: Tensor) -> list[str]:
    """Two rows of a table: shares of all wrong pixels (2,bands), by distance."""
    shares = wrong / wrong.sum().clamp_min(1)
    names = ("not road called road", "road missed")
    return [
        f"| {name} | {' | '.join(f'{float(one):.0%}' for one in own)} | {float(own.sum()):.0%} |"
        for name, own in zip(names, shares, strict=True)
    ]


def at_outline(road: Tensor, reach: int) -> Tensor:
    """Where road or other ground, bool (H,W), is at most so many pixels away from the other."""
    window, both = 2 * reach + 1, torch.stack([road, ~road]).to(torch.float32)
    return max_pool2d(both, window, 1, reach).min(0).values > 0


def row(name: str, count: int, found: Sequence[Tried]) -> str:
    """MaxF / F by detail: as shipped, then with the log odds as they are."""
    shown = [
        " | ".join(f"{one.maxf:.3f} / {one.f:.3f}" for one in found if one.calibration == centre)
        for centre in CENTRES
    ]
    return f"| {name} | {count} | {' | '.join(shown)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="How should fusion trust corrected weights?")
    parser.add_argument("data", type=Path, help="holds idd_lite/, camvid/ and many/")
    parser.add_argument("--out", type=Path, default=Path("out/corrections"), help="to work in")
    parser.add_argument("--curves", nargs="+", help="all if not given")
    parser.add_argument("--count", type=int, default=5, help="corrected pictures")
    parser.add_argument("--set", dest="assignments", nargs="+", default=[], help="of training")
    given = parser.parse_args()
    torch.set_num_threads(1)
    values = merge(read_settings_file(CONFIG), parse_assignments(given.assignments))
    study = Study(given.out, given.out / "none", values, "")
    for curve in choosing_curves(given.data):
        if curve.name in (given.curves or (curve.name,)) and given.count <= len(curve.pool):
            shipped = score(load_detector("fusion"), curve)
            print(f"{curve.name}: shipped {shipped['maxf']:.3f} / {shipped['f']:.3f}", flush=True)
            own = learned(study, curve, given.count)
            print(row(curve.name, given.count, tried(own["weights"], curve)))
            print(f"wrong pixels up to {REACHES} pixels from an outline, farther, all:")
            print(*told_wrong(wrong_pixels(load_detector("fusion", **own), curve)), sep="\n")


if __name__ == "__main__":
    main()
