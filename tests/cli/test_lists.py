"""Output of detectors and export."""

from pathlib import Path

import pytest

from roadtorch.detectors.catalogue import detector_groups
from roadtorch.detectors.detector import Detector
from roadtorch.export import export, folders
from roadtorch.export.export import ExportResult, Parity
from roadtorch.imaging.color import REPRESENTATIONS
from roadtorch.oneclass import CLASSIFIERS
from tests.command import Call


def test_detectors_lists_every_one_with_its_summary(call: Call) -> None:
    result, family = call("detectors"), call("detectors", "cpf*").stdout.splitlines()

    lines = result.stdout.splitlines()
    assert result.exit_code == 0
    named = [line.split() for line in lines if line[0] != " "]
    assert [words[0] for words in named] == list(detector_groups())
    assert all(len(words) > 1 for words in named)
    assert max(map(len, lines)) <= 100
    assert [line.split()[0] for line in family] == ["cpf", "cpf:squares", "cpf:v2"]


def test_the_one_class_grid_is_listed_by_its_options(call: Call) -> None:
    text = call("detectors").stdout

    grid, letter = text.index("oneclass:<classifier>"), text.index("<planes>:paper")
    _, *options = text[grid : text.rindex("\n", 0, letter)].split("\n  <")
    listed = {first: words for first, *words in map(str.split, options)}
    assert listed == {"classifier>": [*CLASSIFIERS], "planes>": [*REPRESENTATIONS]}
    assert "310 detectors, 'oneclass:*' lists them" in " ".join(text.split())


def test_a_detectors_own_defaults_of_shared_settings_are_printed(call: Call) -> None:
    """Compare two detectors with the same group of settings, and different defaults for it."""
    for name, pixels in (("cpf", "76800"), ("oneclass:gaussian:HS", "307200")):
        lines = call("detectors", name).stdout.splitlines()
        assert [line.split()[2] for line in lines if line.startswith("working.pixels")] == [pixels]


def test_detectors_name_explains_its_settings_in_a_hundred_columns(call: Call) -> None:
    lines = call("detectors", "fusion").stdout.splitlines()

    cells = {line.split()[0]: line for line in lines if line[:1].strip()}
    assert max(map(len, lines)) <= 100
    assert {"calibration.centre", "working.pixels", "mirrored"} <= set(cells)
    assert "number" in cells["threshold"]
    assert "≥ 0, ≤ 1" in cells["threshold"]
    assert "drop | keep" in cells["isolated"]
    assert "320ths" in cells["seed_area.width"]


# --- export -----------------------------------------------------------------------------


def test_export_names_its_file(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def written(detector: Detector, out: Path, content: str = "maps") -> ExportResult:
        out.write_bytes(bytes(20_000))
        part = f"the whole of {detector.name}"
        notes = {"part": part, "lacks": "a soul, trust", "threshold": "0.4"}
        return ExportResult((out,), notes, Parity(2e-5, "road at 16×16", 1e-7, 6))

    monkeypatch.setattr(export, "export_detector", written)
    out = tmp_path / "road.onnx"

    result = call(*("export", "prior:rows", "--out", out, "--set", "threshold=0.4"))

    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    assert result.stdout.splitlines() == [
        f"{out}: 0.02 MB",
        "prior:rows: the whole of prior:rows",
        "  threshold          0.4",
        "difference from Python on 6 rendered images: at most 2.0e-05 (road at 16×16), "
        "mean 1.0e-07; allowed 0.0001",
        "Not included: a soul, trust. See docs/export.md for the cost.",
    ]

    monkeypatch.setattr(folders, "export_page", lambda detector, out: written(detector, out / "a"))
    page = call("export", "prior:rows", "--format", "web", "--out", tmp_path / "page")

    assert page.exit_code == 0, page.stderr
    assert "Not included" not in page.stdout  # the page has these steps
    assert page.stdout.splitlines()[-1].startswith("try it: python -m http.server")
