import json

import pytest

from roadtorch.installation import report
from roadtorch.installation.check import Check
from tests.cli.conftest import Call


def planted(monkeypatch: pytest.MonkeyPatch, check: Check) -> None:
    monkeypatch.setattr(report, "_looked", lambda *_: [check])


def test_a_sound_installation_is_told_line_by_line(call: Call) -> None:
    result = call("doctor")

    for section in report.SECTIONS:
        assert f"\n{section}\n" in result.stdout
    assert "  ok       layout.safetensors" in result.stdout
    assert "  ok       fusion" in result.stdout
    assert (result.exit_code, result.stderr) == (int("broken" in result.stdout), "")


def test_something_broken_exits_1(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    planted(monkeypatch, Check("torch", "broken", "is not installed", "pip install torch"))

    result = call("doctor")

    assert result.exit_code == 1
    assert "broken   torch  is not installed (pip install torch)" in result.stdout


def test_something_missing_exits_0(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    planted(monkeypatch, Check("video", "missing", "PyAV is not installed", "…"))

    result = call("doctor", "--json")

    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert document["well"] is True
    assert {one["section"] for one in document["checks"]} == {*report.SECTIONS}
