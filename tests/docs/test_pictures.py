"""The pictures of README are of what ships."""

import json
from pathlib import Path

from scripts.readme_pictures import made_with

PICTURES = Path(__file__).resolve().parents[2] / "docs" / "pictures"


def test_the_pictures_were_made_with_the_weights_and_settings_that_ship() -> None:
    """Else: python scripts/readme_pictures.py DATA."""
    assert json.loads((PICTURES / "made.json").read_text(encoding="utf-8")) == made_with()
