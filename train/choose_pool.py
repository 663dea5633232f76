"""Choose how far `fusion` trusts its network, and its calibration, for other weights.

    python -m train.choose_pool DATA --detector fusion

DATA holds ``many/`` and ``camvid/``; cameras and masks are those of ``train.choose_many``, and so
is the rule: the best mean F over the cameras with one calibration for all. Chosen are the ``share``
of the layout's pool, ``learned.weight``, ``learned.detail``, ``calibration.own`` and ``.centre``.
What the cameras have with what the others choose is told as well. IDD has no part.
"""

import argparse
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from roadtorch import Detection, load_detector
from roadtorch.data.dataset import Truth
from roadtorch.evaluation.metrics import (
    RoadCounts,
    count_levels,
    decisions_at,
    f_measure,
    max_f,
)
from roadtorch.road.fusion import centred_odds, log_odds
from train.choose_many import CENTRES, pictures

SHARES = (0.65, 0.8)
WEIGHTS = (0.25, 0.5, 1.0)
DETAILS = (0.25, 0.5, 1.0)
OWNS = (0.0, 0.25)
LEVELS = 1024
"""Of the log odds, as likelihoods, at which pixels are counted."""

SPREAD = 4.0
"""Log odds are divided by this before they are counted: few are beyond the levels then."""


class Choice(NamedTuple):
    """share: of the layout's pool. weight, detail: of the learned road. own: of Otsu."""

    share: float
    weight: float
    detail: float
    own: float


class Worth(NamedTuple):
    """Of one choice, by camera: F at each of CENTRES (cameras, centres), MaxF (cameras,)."""

    f: np.ndarray
    maxf: np.ndarray


def tables(root: Path, detector: str) -> Iterator[tuple[Choice, Worth]]:
    """What each choice is worth; pictures are looked at once for each share and weight."""
    for share, weight in product(SHARES, WEIGHTS):
        found = load_detector(
            detector,
            share=share,
            learned={"weight": weight, "detail": 0.0},
            calibration={"centre": 0.0, "own": 0.0, "temperature": SPREAD},
        )
        counts: dict[tuple[float, float], dict[str, RoadCounts]] = {
            each: {} for each in product(DETAILS, OWNS)
        }
        for camera, detection, truth in pictures(root, found):
            for each, more in counted(detection, truth):
                known = counts[each]
                known[camera] = known[camera] + more if camera in known else more
        for each, by_camera in counts.items():
            yield Choice(share, weight, *each), worth_of(by_camera, each[1])


def counted(found: Detection, truth: Truth) -> Iterator[tuple[tuple[float, float], RoadCounts]]:
    """By detail and own, the pixels of one detection whose calibration is plain."""
    free = ~found.cues["ego"]  # on the ego car the likelihood is 0, which is far from the others
    odds = SPREAD * torch.logit(found.likelihood[free], eps=1e-6)
    learned = log_odds(found.cues["learned_road"])[free]
    for detail, own in product(DETAILS, OWNS):
        centred = centred_odds(odds + detail * learned, 0.0, own)
        seen = torch.zeros_like(found.likelihood)
        seen[free] = (centred / SPREAD).sigmoid()
        yield (detail, own), count_levels(seen, truth.road, truth.valid, LEVELS)


def worth_of(by_camera: Mapping[str, RoadCounts], own: float) -> Worth:
    """F at each centre and MaxF of the cameras' counts."""
    levels = [1 / (1 + np.exp(-(1 - own) * centre / SPREAD)) for centre in CENTRES]
    f = [
        [float(f_measure(decisions_at(one, level))) for level in levels]
        for one in by_camera.values()
    ]
    return Worth(np.array(f), np.array([float(max_f(one)[0]) for one in by_camera.values()]))


def told(choice: Choice, worth: Worth) -> str:
    """One line: the choice, its best centre, mean F there, the worst camera, mean MaxF."""
    at = int(worth.f.mean(0).argmax())
    names = " ".join(f"{name} {value:<4g}" for name, value in choice._asdict().items())
    f, maxf = worth.f[:, at], worth.maxf.mean()
    return (
        f"{names} centre {CENTRES[at]:+.2f}: F {f.mean():.4f} worst {f.min():.3f} MaxF {maxf:.4f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose how far fusion trusts its network.")
    parser.add_argument("data", type=Path, help="the folder that holds many/ and camvid/")
    parser.add_argument("--detector", default="fusion")
    given = parser.parse_args()
    torch.set_num_threads(1)
    found = dict(tables(given.data, given.detector))
    for choice, worth in sorted(found.items(), key=lambda each: -each[1].f.mean(0).max()):
        print(told(choice, worth))
    print("held out:", round(held_out(list(found.values())), 4))


def held_out(worths: list[Worth]) -> float:
    """Mean F of the cameras, each with the choice and the centre that the others prefer."""
    f = np.stack([worth.f for worth in worths])  # choice, camera, centre
    told_f = []
    for camera in range(f.shape[1]):
        others = np.delete(f, camera, 1).mean(1)
        choice, centre = np.unravel_index(others.argmax(), others.shape)
        told_f.append(f[choice, camera, centre])
    return float(np.mean(told_f))


if __name__ == "__main__":
    main()
