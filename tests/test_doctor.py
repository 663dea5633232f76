"""roadtorch doctor: what is there, what is missing, what is broken, and what is told of it."""

import json
import shutil
import sys
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner, Result

from roadtorch import doctor
from roadtorch.cli import main
from roadtorch.detector import Detector
from roadtorch.doctor import Check
from roadtorch.io import decoding
from roadtorch.layout import weights

GOOD = Check("torch", "ok", "2.13.0", figures={"threads": 2})
LESS = Check("video", "missing", "PyAV is not installed", "pip install 'roadtorch[video]'")
BAD = Check("weights", "broken", "is damaged", "install roadtorch again")


def call(*words: str) -> Result:
    return CliRunner().invoke(main, ["doctor", *words])


# --- the command ------------------------------------------------------------------------


def test_a_sound_installation_is_told_line_by_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "MAX_ROUNDS", 2)

    result = call()

    for section in doctor.SECTIONS:
        assert f"\n{section}\n" in result.stdout
    assert "  ok       layout.safetensors" in result.stdout
    assert "  ok       fusion" in result.stdout
    assert (result.exit_code, result.stderr) == (int("broken" in result.stdout), "")


@pytest.mark.parametrize(("check", "code"), [(GOOD, 0), (LESS, 0), (BAD, 1)])
def test_only_what_is_broken_exits_1(
    monkeypatch: pytest.MonkeyPatch, check: Check, code: int
) -> None:
    monkeypatch.setattr(doctor, "SECTIONS", {"one": lambda: [GOOD], "other": lambda: [check]})

    text, document = call(), call("--json")

    assert (text.exit_code, document.exit_code) == (code, code)
    remedy = f" ({check.remedy})" if check.remedy else ""
    assert f"  {check.state:<8} {check.name}" in text.stdout
    assert text.stdout.endswith(f"  {check.what}{remedy}\n")
    found = json.loads(document.stdout)
    assert found["well"] is (code == 0)
    assert found["checks"][0] == {
        "section": "one",
        "name": "torch",
        "state": "ok",
        "what": "2.13.0",
        "remedy": "",
        "figures": {"threads": 2},
    }


def test_a_section_that_fails_breaks_itself_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> list[Check]:
        import roadtorch.no_such_module  # pyright: ignore[reportMissingImports]

        return roadtorch.no_such_module

    machine = doctor.check_machine
    monkeypatch.setattr(doctor, "SECTIONS", {"gone": gone, "machine": machine})

    found = doctor.examine()

    assert found["gone"][0].state == "broken"
    assert found["gone"][0].what.startswith("ModuleNotFoundError: No module named")
    assert {one.state for one in found["machine"]} == {"ok"}
    assert [one.name for one in found["machine"]][:2] == ["roadtorch", "python"]


# --- packages ---------------------------------------------------------------------------

REQUIRES = [
    "numpy>=1.26",
    "torch>=999",
    "not-there>=1",
    "only-windows>=1; sys_platform == 'none'",
    'not-there-either>=2; extra == "video"',
    'click>=8; extra == "grid"',
    'pytest>=8; extra == "test"',
]


def test_packages_and_extras_that_are_absent_come_with_the_line_that_mends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Metadata:
        def get_all(self, _: str) -> list[str]:
            return ["video", "grid", "test"]

    monkeypatch.setattr(doctor, "requires", lambda _: REQUIRES)
    monkeypatch.setattr(doctor, "metadata", lambda _: Metadata())

    numpy, absent, torch = sorted(doctor.check_packages(), key=lambda one: one.name != "numpy")
    grid, video = doctor.check_extras()

    assert (numpy.name, numpy.state, numpy.remedy) == ("numpy", "ok", "")
    assert (absent.name, absent.state, absent.what) == ("not-there", "broken", "is not installed")
    assert absent.remedy == "pip install 'not-there>=1'"
    assert torch.state == "broken"
    assert torch.what.endswith("is there, and >=999 is needed")
    assert (grid.name, grid.state) == ("grid", "ok")
    assert grid.what.startswith("click 8")
    assert (video.name, video.state) == ("video", "missing")
    assert video.what == "not-there-either is not installed"
    assert video.remedy == "pip install 'roadtorch[video]'"


# --- pictures and videos ----------------------------------------------------------------


def test_every_format_that_is_read_can_be() -> None:
    *pictures, video = doctor.check_codecs()

    assert [one.state for one in pictures] == ["ok"] * len(doctor.SUFFIXES)
    assert (video.name, video.state) == ("video", "ok")
    assert "reads h264" in video.what


def test_formats_that_fail_or_come_back_otherwise_are_broken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(_: bytes) -> None:
        raise ValueError("no such codec\nand more")

    decode = decoding.decode
    for other, what in (
        (fails, "no such codec"),
        (lambda data: 255 - decode(data) // 2, "comes back as another picture"),
    ):
        monkeypatch.setattr(decoding, "decode", other)
        pictures = doctor.check_codecs()[:-1]
        assert {(one.state, one.what) for one in pictures} == {("broken", what)}


def test_without_pyav_video_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setattr(doctor, "find_spec", lambda _: None)

    video = doctor.check_codecs()[-1]

    assert (video.state, video.remedy) == ("missing", "pip install 'roadtorch[video]'")


# --- weights ----------------------------------------------------------------------------


def test_the_shipped_weights_are_what_their_cards_state() -> None:
    found = {one.name: one for one in doctor.check_weights()}

    assert {"cnn-7.safetensors", "layout.safetensors"} <= {*found}
    assert {one.state for one in found.values()} == {"ok"}
    assert found["layout.safetensors"].what.endswith("as layout.md states")


def test_other_bytes_and_no_weights_at_all_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bare").mkdir()
    for path in weights.SHIPPED.glob("cnn-7.*"):
        shutil.copy(path, tmp_path)
    changed = tmp_path / "cnn-7.safetensors"
    changed.write_bytes((weights.SHIPPED / "cnn-7-paper.safetensors").read_bytes())

    monkeypatch.setattr(weights, "SHIPPED", tmp_path)
    (check,) = doctor.check_weights()
    monkeypatch.setattr(weights, "SHIPPED", tmp_path / "bare")
    (none,) = doctor.check_weights()

    assert check.state == "broken"
    assert check.what == "is not the file whose SHA-256 cnn-7.md states"
    assert (none.state, none.what) == ("broken", "none are there")


# --- a street ---------------------------------------------------------------------------


def test_fusion_finds_the_rendered_street(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "MAX_ROUNDS", 3)

    (check,) = doctor.check_self_test()

    assert check.state == "ok"
    assert check.figures["f"] > 0.9
    assert check.figures["rounds"] == 3
    assert check.figures["peak_mib"] > 100
    assert check.what.startswith(f"F {check.figures['f']:.3f}, ")


def test_a_detector_that_is_wrong_or_wavers_is_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    detect = Detector.detect
    monkeypatch.setattr(doctor, "MAX_ROUNDS", 1)
    monkeypatch.setattr(doctor, "MIN_F", 0.999)
    (wrong,) = doctor.check_self_test()

    def wavering(self: Detector, *given: object, **named: object) -> object:
        detection = detect(self, *given, **named)  # pyright: ignore[reportArgumentType]
        detection.likelihood[0, 0] = torch.rand(())
        return detection

    monkeypatch.setattr(doctor, "MIN_F", 0.5)
    monkeypatch.setattr(Detector, "detect", wavering)
    (unsteady,) = doctor.check_self_test()

    assert (wrong.state, unsteady.state) == ("broken", "broken")
    assert wrong.what.endswith("; F is to be 0.999")
    assert unsteady.what.endswith("; two runs differ")
