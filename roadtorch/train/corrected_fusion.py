"""How far ``fusion`` trusts a network that has learned from corrections. Ours.

Few corrected pictures leave the other cues their say; many make the network's road the better
judge. Chosen on material that no table reports (docs/corrections.md).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from roadtorch.data.correction_labels import NOT_ROAD, ROAD_SAID
from roadtorch.data.corrections import Correction
from roadtorch.io.atomic import write_text
from roadtorch.settings import toml_lines

MOST = 3.0
"""Weight of the network's road, pixel by pixel, after very many corrected pictures."""

HALFWAY = 10.0
"""Corrected pictures that bring half of it."""


def pictures_said(corrections: Sequence[Correction]) -> float:
    """How many whole pictures it makes: the sum of the shares that people called road or not."""
    roads = [one.road for one in corrections]
    return float(sum(((road == ROAD_SAID) | (road == NOT_ROAD)).mean() for road in roads))


def trust_settings(pictures: float) -> dict[str, Any]:
    """Settings of ``fusion`` after so many corrected pictures (> 0).

    The detail grows as a mean does that is drawn to nothing known: n / (n + HALFWAY). True labels
    make 0 the log odds that part road from background: neither the centre of machine labels nor
    the picture's own (Otsu) is asked.
    """
    detail = MOST * pictures / (pictures + HALFWAY)
    return {
        "learned": {"weight": 1.0, "detail": round(detail, 3)},
        "calibration": {"centre": 0.0, "own": 0.0},
    }


def write_corrected(path: Path, weights: Path, corrections: Sequence[Correction]) -> bool:
    """Write a file for ``--config``: ``fusion`` with these weights, trusted as far as they learned.

    False, and nothing written, where people called no pixel road or not road.
    """
    said = pictures_said(corrections)
    if not said:
        return False
    lines = [
        f"# From {len(corrections)} pictures that people corrected: not label-free.",
        'detector = "fusion"',
        *toml_lines({"weights": {"file": str(weights.resolve())}, **trust_settings(said)}),
    ]
    write_text(path, "\n".join([*lines, ""]))
    return True
