"""Where the road begins on a camera: the centre of ``fusion``'s log odds, from corrected pictures.

Few corrected pictures say well what parts road from background on their camera: it is one number.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.data.correction_labels import NOT_ROAD, ROAD_SAID
from roadtorch.data.corrections import Correction
from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.fusion import RoadCalibration
from roadtorch.errors import ConfigError
from roadtorch.evaluation.metrics import RoadCounts, count_levels, max_f
from roadtorch.files import write_text
from roadtorch.fusion import log_odds
from roadtorch.image import read_image
from roadtorch.otsu import otsu_threshold
from roadtorch.settings import toml_lines

LEVELS = 4096
"""Of the likelihoods that are counted."""

PRIOR = 3.0
"""Pictures' worth of the centre that is the default: a few pictures do not move it all the way."""


class SaidOdds(NamedTuple):
    """One corrected picture: log odds of road (H,W), and where people said road, or anything."""

    odds: Tensor
    road: Tensor
    known: Tensor


def uncalibrated(weights: Path) -> Detector:
    """``fusion`` with weights of one's own and log odds as they are."""
    plain = RoadCalibration(centre=0, own=0, temperature=1).model_dump()
    return load_detector("fusion", weights={"file": str(weights)}, calibration=plain)


def said_odds(detector: Detector, corrections: Iterable[Correction]) -> list[SaidOdds]:
    """What a detector with log odds as they are says of corrected pictures that have road."""
    found = []
    for one in corrections:
        road = torch.from_numpy(one.road)
        likelihood = detector.detect(read_image(one.picture)).likelihood
        if bool((road == ROAD_SAID).any()):
            known = (road == ROAD_SAID) | (road == NOT_ROAD)
            found.append(SaidOdds(log_odds(likelihood), road == ROAD_SAID, known))
    return found


def fitted_centre(
    pictures: Sequence[SaidOdds], calibration: RoadCalibration, prior: float = PRIOR
) -> float:
    """The centre with which F at 0.5 is highest on corrected pixels, all pictures together.

    Drawn to the default by ``prior`` pictures. Raises ConfigError without a pixel of road, and
    where each picture's own threshold leaves nothing to choose.
    """
    if not pictures or calibration.own >= 1:
        raise ConfigError("corrections", "say of no pixel that it is road", "correct some more")
    counts = sum(
        (_counts(one, calibration.own) for one in pictures),
        RoadCounts(torch.zeros(LEVELS, dtype=torch.int64), torch.zeros(LEVELS, dtype=torch.int64)),
    )
    level = min(max(float(max_f(counts)[1]), 1 / LEVELS), 1 - 1 / LEVELS)
    best = math.log(level / (1 - level)) / (1 - calibration.own)
    count = len(pictures)
    centre = (count * best + prior * calibration.centre) / (count + prior)
    return round(min(max(centre, -20), 20), 3)


def _counts(one: SaidOdds, own: float) -> RoadCounts:
    """Corrected pixels by level of what the centre is compared with."""
    moved = one.odds - own * otsu_threshold(one.odds)
    return count_levels(moved.sigmoid(), one.road, one.known, LEVELS)


def write_calibrated(path: Path, weights: Path, corrections: Sequence[Correction]) -> bool:
    """Write a file for ``--config``: ``fusion`` with these weights and the centre that fits.

    False, and nothing written, where people said of no pixel that it is road.
    """
    odds = said_odds(uncalibrated(weights), corrections)
    if not odds:
        return False
    centre = fitted_centre(odds, RoadCalibration())
    lines = [
        f"# The centre fits {len(odds)} pictures that people corrected: not label-free.",
        'detector = "fusion"',
        *toml_lines({"weights": {"file": str(weights.resolve())}}),
        *toml_lines({"calibration": {"centre": centre}}),
    ]
    write_text(path, "\n".join([*lines, ""]))
    return True
