"""Where the road begins on a camera: the centre of ``fusion``'s log odds, from corrected pictures.

Few corrected pictures say well what parts road from background on their camera: it is one number.
"""

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import add
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
from roadtorch.evaluation.metrics import RoadCounts, count_levels, f_curve
from roadtorch.files import write_text
from roadtorch.fusion import log_odds
from roadtorch.image import read_image
from roadtorch.otsu import otsu_threshold
from roadtorch.settings import toml_lines

LEVELS = 4096
"""Of the likelihoods that are counted."""

WITHIN = (1 / LEVELS, 1 - 1 / LEVELS)
"""Likelihoods that are told apart from 0 and 1."""

SPREAD = 1.5
"""Standard deviation of the centre from camera to camera, log odds; ours, from a few cameras."""

AS_GOOD = 0.002
"""F that may be lost: of all centres within it of the best, the middle is taken."""


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


def fitted_centre(pictures: Sequence[SaidOdds], calibration: RoadCalibration) -> float:
    """The centre with which F at 0.5 is highest on corrected pixels, all pictures together.

    Drawn to the default as far as the pictures' own centres differ (empirical Bayes; Efron and
    Morris, 1973): few or unlike pictures move it little. Raises ConfigError without a pixel of
    road, and where each picture's own threshold leaves nothing to choose.
    """
    if not pictures or calibration.own >= 1:
        raise ConfigError("corrections", "say of no pixel that it is road", "correct some more")
    counts = [_counts(one, calibration.own) for one in pictures]
    total = reduce(add, counts)
    each = torch.tensor([best_centre(one) for one in counts]) / (1 - calibration.own)
    doubt = float(each.var()) / len(each) if len(each) > 1 else SPREAD**2
    trusted = SPREAD**2 / (SPREAD**2 + doubt)
    best = best_centre(total) / (1 - calibration.own)
    return round(trusted * best + (1 - trusted) * calibration.centre, 3)


def best_centre(counts: RoadCounts) -> float:
    """The log odds, in the middle of those as good, from which on road is best told."""
    curve = f_curve(counts)
    good = (curve >= curve.max() - AS_GOOD).nonzero()[:, 0].double() / (counts.levels - 1)
    low, high = (torch.logit(end.clamp(*WITHIN)) for end in (good[0], good[-1]))
    return float((low + high) / 2)


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
