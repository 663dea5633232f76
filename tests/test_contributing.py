"""The example of CONTRIBUTING.md, run as it stands there."""

import re
import sys
from pathlib import Path
from textwrap import dedent
from types import ModuleType

import pytest

DOCUMENT = Path(__file__).resolve().parents[1] / "CONTRIBUTING.md"


def test_the_documented_detector_keeps_to_the_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.S)
    module = ModuleType("their_package")
    monkeypatch.setitem(sys.modules, "their_package", module)

    exec("\n".join(map(dedent, blocks)), vars(module))

    assert module.ENTRY.name == "bright"
    assert module.check_detector
