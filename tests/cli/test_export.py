from pathlib import Path

import pytest

from roadtorch.detectors.detector import Detector
from roadtorch.export import export
from roadtorch.export.export import Exported, Parity
from tests.command import Call


def test_export_reports_its_file(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def written(detector: Detector, out: Path) -> Exported:
        out.write_bytes(bytes(20_000))
        part = f"the whole of {detector.name}"
        notes = {"part": part, "lacks": "a soul, trust", "threshold": "0.4"}
        return Exported((out,), notes, Parity(2e-5, "road at 16×16", 1e-7, 6))

    monkeypatch.setattr(export, "export_detector", written)
    out = tmp_path / "road.onnx"

    result = call(
        *("export", "prior:rows", "--out", out, "--set", "threshold=0.4"),
    )

    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    assert result.stdout.splitlines() == [
        f"{out}: 0.02 MB",
        "prior:rows: the whole of prior:rows",
        "  threshold          0.4",
        "parity with Python on 6 rendered pictures: at most 2.0e-05 off (road at 16×16), "
        "1.0e-07 in the mean; allowed 0.0001",
        "It lacks: a soul, trust. What that costs: docs/export.md",
    ]
