import json

import pytest

from roadtorch.installation import report
from roadtorch.installation.check import Check

GOOD = Check("torch", "ok", "2.13.0", figures={"threads": 2})
LESS = Check("video", "missing", "PyAV is not installed", "pip install 'roadtorch[video]'")
BAD = Check("weights", "broken", "is damaged", "install roadtorch again")


def test_a_section_that_cannot_be_imported_breaks_itself_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sections = {
        "gone": "roadtorch.installation.no_such_module:check",
        "machine": report.SECTIONS["machine"],
    }
    monkeypatch.setattr(report, "SECTIONS", sections)

    found = report.examine()

    (gone,) = found["gone"]
    assert gone.state == "broken"
    assert gone.what.startswith("ModuleNotFoundError: No module named")
    assert {one.state for one in found["machine"]} == {"ok"}
    assert [one.name for one in found["machine"]][:2] == ["roadtorch", "python"]


def test_every_section_can_be_imported() -> None:
    for place in report.SECTIONS.values():
        module, name = place.split(":")
        assert callable(getattr(report.importlib.import_module(module), name))


def test_what_is_missing_is_no_fault_and_what_is_broken_is() -> None:
    assert report.is_well({"a": [GOOD, LESS]})
    assert not report.is_well({"a": [GOOD], "b": [BAD]})


def test_the_text_has_a_line_for_each_with_its_remedy() -> None:
    lines = report.as_text({"packages": [GOOD], "codecs": [LESS]}).splitlines()

    assert lines[2:4] == ["packages", "  ok       torch  2.13.0"]
    assert lines[-1] == ("  missing  video  PyAV is not installed (pip install 'roadtorch[video]')")


def test_the_document_is_json_with_the_figures() -> None:
    document = json.loads(json.dumps(report.as_document({"packages": [GOOD], "x": [BAD]})))

    assert document["well"] is False
    assert document["checks"][0] == {
        "section": "packages",
        "name": "torch",
        "state": "ok",
        "what": "2.13.0",
        "remedy": "",
        "figures": {"threads": 2},
    }
