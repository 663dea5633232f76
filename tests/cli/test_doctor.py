"""roadtorch doctor: parts that are installed, missing or broken."""

import re
import sys
from base64 import urlsafe_b64encode
from hashlib import sha256
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest
import torch

from roadtorch.cli import doctor
from roadtorch.cli.doctor import Check
from roadtorch.detectors.detector import Detector
from roadtorch.layout import runtimes, weights
from tests.command import Call


def test_a_sound_installation_line_by_line(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "ROUNDS", 2)

    result = call("doctor")

    lines = [line.split(maxsplit=2) for line in result.stdout.splitlines() if line[:2] == "  "]
    checks = {name: (state, problem) for state, name, problem in lines}
    assert (result.exit_code, result.stderr) == (0, "")
    for name in ("backbone-free.safetensors", "cnn-7.safetensors", "video", "fusion", "torch"):
        assert checks[name][0] == "ok", checks[name]
    assert "reads h264" in checks["video"][1]
    assert checks["backbone-free.safetensors"][1] == "SHA-256 ab2ba666fb88…"
    assert checks["fusion"][1].startswith("F 0.9")
    for runtime in ("torch", "onnxruntime"):
        assert re.search(rf"ok +fusion, {runtime} +\d+\.\d ms, \d+\.\d fps", result.stdout)


def test_files_that_an_interrupted_pip_left_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "roadtorch-1.dist-info").mkdir()
    for name in ("sound.py", "empty.py"):
        (tmp_path / name).write_text("" if name == "empty.py" else "x = 1")
    of_text = "sha256=" + urlsafe_b64encode(sha256(b"x = 1").digest()).decode().rstrip("=")
    rows = [f"{name},{of_text},5\n" for name in ("sound.py", "empty.py", "absent.py")]
    (tmp_path / "roadtorch-1.dist-info" / "RECORD").write_text("".join(rows))
    installed = PathDistribution(tmp_path / "roadtorch-1.dist-info")
    monkeypatch.setattr(doctor, "distribution", lambda name: installed)
    monkeypatch.setattr(doctor, "walk_packages", lambda *_, **__: [])

    checks = doctor.check_files()

    problems = {check.name: (check.state, check.details) for check in checks}
    differs = "broken", "differs from what was installed"
    assert problems == {"empty.py": differs, "absent.py": ("broken", "is missing")}
    assert {check.hint for check in checks} == {doctor.REINSTALL_HINT}


@pytest.mark.parametrize(
    ("installed", "state", "problem"),
    [
        (None, "missing", "needs onnxruntime: not installed (pip install 'roadtorch[onnx]')"),
        (object(), "broken", "cannot compile the network: no such instruction"),
    ],
)
def test_the_bench_lists_runtimes_that_are_missing_or_broken(
    call: Call, monkeypatch: pytest.MonkeyPatch, installed: object, state: str, problem: str
) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("no such instruction")

    monkeypatch.setattr(doctor, "ROUNDS", 1)
    monkeypatch.setattr(
        runtimes, "find_spec", lambda name: installed if name == "onnxruntime" else object()
    )
    monkeypatch.setattr(runtimes, "network_graph", fails)

    result = call("doctor", "--bench")

    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    assert result.exit_code == (state == "broken")
    for name in doctor.BENCH_DETECTORS:
        assert any(line.startswith(f"ok {name}, torch") for line in lines)
        assert any(line.startswith(f"{state} {name}, onnxruntime {problem}") for line in lines)
    assert "weights" not in lines


def test_a_failing_section_breaks_itself_alone(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> list[Check]:
        raise ModuleNotFoundError("No module named 'torch'\nand more")

    good = Check("torch", "ok", "2.13.0")
    missing = Check("video", "missing", "is not", "fix it")
    monkeypatch.setattr(doctor, "CHECKS", {"one": lambda: [good, missing], "gone": fails})

    result = call("doctor")

    assert result.exit_code == 1
    assert [" ".join(line.split()) for line in result.stdout.splitlines()[1:]] == [
        *("", "one", "ok torch 2.13.0", "missing video is not (fix it)", "", "gone"),
        f"broken gone ModuleNotFoundError: No module named 'torch' ({doctor.REINSTALL_HINT})",
    ]


def test_missing_packages_come_with_their_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    class Metadata:
        def get_all(self, _: str) -> list[str]:
            return ["video", "grid", "test"]

    needed = ["numpy>=1.26", "not-there>=1", 'not-there-either>=2; extra == "video"']
    needed += ['click>=8; extra == "grid"', 'not-there>=8; extra == "test"']
    needed += ['module-of-click; extra == "grid"']  # as onnxruntime is of onnxruntime-gpu
    packages = {"module-of-click": ["click"]}
    monkeypatch.setattr(doctor, "packages_distributions", lambda: packages)
    monkeypatch.setattr(doctor, "requires", lambda _: needed)
    monkeypatch.setattr(doctor, "metadata", lambda _: Metadata())
    monkeypatch.setitem(sys.modules, "av", None)

    absent, numpy, grid, video = doctor.check_packages()

    problem = "not-there-either not installed"
    assert absent == Check("not-there", "broken", "is not installed", "pip install not-there")
    assert (numpy.name, numpy.state, numpy.hint) == ("numpy", "ok", "")
    assert (grid.name, grid.state, grid.details[:7]) == ("grid", "ok", "click 8")
    assert video == Check("video", "missing", problem, "pip install 'roadtorch[video]'")
    assert [check.state for check in doctor.check_video()] == ["missing"]


def test_other_bytes_and_missing_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bare").mkdir()
    data = (weights.SHIPPED / "cnn-7.safetensors").read_bytes()
    (tmp_path / "cnn-7.safetensors").write_bytes(data[:-5] + b"mouse")

    for folder, problem in (
        (tmp_path, "is damaged: its weights do not match the hash in its header"),
        (tmp_path / "bare", "no weight files"),
    ):
        monkeypatch.setattr(weights, "SHIPPED", folder)
        (check,) = doctor.check_weights()
        assert (check.state, check.details) == ("broken", problem)


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
    assert wrong.details.endswith("; F should be at least 0.999")
    assert unsteady.details.endswith("; not deterministic: two results for one image")
