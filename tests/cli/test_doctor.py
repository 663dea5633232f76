"""roadtorch doctor: what is there, what is missing, what is broken, and what is told of it."""

import json
from pathlib import Path

import pytest
import torch

from roadtorch.cli import doctor
from roadtorch.cli.doctor import Check
from roadtorch.detectors.detector import Detector
from roadtorch.layout import weights
from tests.command import Call, call

__all__ = ["call"]


# --- the command ------------------------------------------------------------------------


def test_a_sound_installation_is_told_line_by_line(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "ROUNDS", 2)

    result = call("doctor", "--json")

    document = json.loads(result.stdout)
    checks = {check["name"]: check for check in document["checks"]}
    assert (result.exit_code, result.stderr) == (int(not document["well"]), "")
    assert {check["section"] for check in checks.values()} == set(doctor.SECTIONS)
    assert [*checks][:2] == ["roadtorch", "python"]
    weights = ("layout-free.safetensors", "cnn-7.safetensors")
    for name in (*weights, "video", "fusion"):
        assert checks[name]["state"] == "ok", checks[name]
    assert "reads h264" in checks["video"]["what"]
    assert "SHA-256 131cbfcc6d36…" in checks["layout-free.safetensors"]["what"]
    figures = checks["fusion"]["figures"]
    assert figures["f"] > 0.9
    assert figures["rounds"] == 2
    assert figures["peak_mib"] > 100
    assert checks["fusion"]["what"].startswith(f"F {figures['f']:.3f}, ")


GOOD = Check("torch", "ok", "2.13.0", figures={"threads": 2})


@pytest.mark.parametrize(
    ("check", "code", "line"),
    [
        (GOOD, 0, "  ok       torch  2.13.0"),
        (Check("video", "missing", "is not", "mend it"), 0, "  missing  video  is not (mend it)"),
        (Check("weights", "broken", "is damaged"), 1, "  broken   weights  is damaged"),
    ],
)
def test_only_what_is_broken_exits_1(
    call: Call, monkeypatch: pytest.MonkeyPatch, check: Check, code: int, line: str
) -> None:
    monkeypatch.setattr(doctor, "SECTIONS", {"one": lambda: [GOOD], "other": lambda: [check]})

    text, document = call("doctor"), call("doctor", "--json")

    assert (text.exit_code, document.exit_code) == (code, code)
    assert "\none\n  ok " in text.stdout
    assert text.stdout.endswith(f"\nother\n{line}\n")
    told = json.loads(document.stdout)
    assert told["well"] is (code == 0)
    assert told["checks"][0] == {
        **{"section": "one", "name": "torch", "state": "ok", "what": "2.13.0", "remedy": ""},
        "figures": {"threads": 2},
    }


def test_a_section_that_fails_breaks_itself_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> list[Check]:
        raise ModuleNotFoundError("No module named 'torch'\nand more")

    monkeypatch.setattr(doctor, "SECTIONS", {"gone": fails, "machine": doctor.check_machine})

    report = doctor.examine()

    what = "ModuleNotFoundError: No module named 'torch'"
    assert report["gone"] == [Check("gone", "broken", what, doctor.AGAIN)]
    assert {check.state for check in report["machine"]} == {"ok"}


# --- packages ---------------------------------------------------------------------------

REQUIRES = [
    "numpy>=1.26",
    "not-there>=1",
    'not-there-either>=2; extra == "video"',
    "click>=8; extra == 'grid'",
    'pytest>=8; extra == "test"',
]


def test_packages_and_extras_that_are_absent_come_with_the_line_that_installs_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Metadata:
        def get_all(self, _: str) -> list[str]:
            return ["video", "grid", "test"]

    monkeypatch.setattr(doctor, "requires", lambda _: REQUIRES)
    monkeypatch.setattr(doctor, "metadata", lambda _: Metadata())

    absent, numpy = doctor.check_packages()
    grid, video = doctor.check_extras()

    assert absent == Check("not-there", "broken", "is not installed", "pip install not-there")
    assert (numpy.name, numpy.state, numpy.remedy) == ("numpy", "ok", "")
    assert (grid.name, grid.state, grid.what[:7]) == ("grid", "ok", "click 8")
    what, install = "not-there-either not installed", "pip install 'roadtorch[video]'"
    assert video == Check("video", "missing", what, install)


# --- videos, weights --------------------------------------------------------------------


def test_without_pyav_video_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda _: None)

    (video,) = doctor.check_codecs()

    assert (video.state, video.remedy) == ("missing", "pip install 'roadtorch[video]'")


def test_other_bytes_and_no_weights_at_all_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bare").mkdir()
    data = (weights.SHIPPED / "cnn-7.safetensors").read_bytes()
    (tmp_path / "cnn-7.safetensors").write_bytes(data[:-5] + b"mouse")

    for folder, what in (
        (tmp_path, "is damaged: its weights are not those that its header states"),
        (tmp_path / "bare", "none are there"),
    ):
        monkeypatch.setattr(weights, "SHIPPED", folder)
        (check,) = doctor.check_weights()
        assert (check.state, check.what) == ("broken", what)


# --- a street ---------------------------------------------------------------------------


def test_a_detector_that_is_wrong_or_wavers_is_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    detect = Detector.detect

    def wavering(detector: Detector, *arguments: object, **named: object) -> object:
        detection = detect(detector, *arguments, **named)  # pyright: ignore[reportArgumentType]
        detection.likelihood[0, 0] = torch.rand(())
        return detection

    monkeypatch.setattr(doctor, "ROUNDS", 1)
    monkeypatch.setattr(doctor, "MIN_F", 0.999)
    (wrong,) = doctor.check_self_test()
    monkeypatch.setattr(doctor, "MIN_F", 0.5)
    monkeypatch.setattr(Detector, "detect", wavering)
    (unsteady,) = doctor.check_self_test()

    assert (wrong.state, unsteady.state) == ("broken", "broken")
    assert wrong.what.endswith("; F is to be 0.999")
    assert unsteady.what.endswith("; two runs differ")
