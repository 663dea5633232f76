"""Modules are where the page of the architecture has them."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_modules_that_the_page_names_exist() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+\.py)`", page)

    assert [name for name in named if not (ROOT / "roadtorch" / name).is_file()] == []
