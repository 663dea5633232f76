"""What detectors said when it was last written down: a change is meant, or a fault."""

import json
from pathlib import Path

import numpy as np

from scripts import freeze

FROZEN = json.loads((Path(__file__).parent / "frozen.json").read_text(encoding="utf-8"))
AWAY = 4.0  # 255ths: how far another machine's arithmetic may move a likelihood, on average


def test_every_detector_says_what_it_said() -> None:
    """Meant to change? `python scripts/freeze.py thumbnails tests/frozen.json` writes it anew."""
    # Other tests of this process may have put detectors of theirs into the catalogue.
    names = [name for name in freeze.detectors() if not name.startswith("test-")]

    now = freeze.thumbnails(names)

    assert list(now) == list(FROZEN)
    before, after = (np.array(list(maps.values())) for maps in (FROZEN, now))
    assert after.shape == (len(FROZEN), 2, 6 * 8)
    away = abs(after - before).mean((1, 2))
    assert [name for name, share in zip(FROZEN, away, strict=True) if share > AWAY] == []
