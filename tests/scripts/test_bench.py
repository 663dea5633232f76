"""The benchmarks: a short run of each, and that two checkouts stay apart."""

import json
import sys
import time
from pathlib import Path

import pytest

from roadtorch.testing.scenes import render_scene, write_picture
from scripts import bench, bench_throughput
from tests.scripts.conftest import PrintedBy

CHECKOUT = Path(__file__).resolve().parents[2]


def test_detectors_stand_beside_their_peers_and_are_kept(
    printed_by: PrintedBy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "KEPT", tmp_path / "kept.json")

    printed = printed_by(bench, "fusion", "--size", 64, 48, "--rounds", 1, "--write")

    assert [line.split("|")[1].strip() for line in printed.splitlines()[2:4]] == [
        "fusion",
        bench.LRASPP,
    ]
    kept = json.loads(bench.KEPT.read_text())["values"]
    assert f"| {kept['bench.fusion.ms']:.1f} | {kept['bench.fusion.of_lraspp']:.2f} |" in printed


def test_contestants_take_turns_and_a_ratio_is_that_of_the_rounds() -> None:
    called: list[str] = []
    calls = {name: lambda name=name: called.append(name) for name in "ab"}

    times = bench.interleaved(calls, 2, time.perf_counter)

    assert {name: len(values) for name, values in times.items()} == {"a": 2, "b": 2}
    assert "".join(called) == "abba" * 2
    assert bench.ratio([2.0, 1.0, 9.0], [1.0, 1.0, 3.0]) == 2.0


def test_a_checkout_has_its_own_package_and_others_stay_loaded() -> None:
    before = dict(sys.modules)

    detects = bench.detects_of(CHECKOUT, ["prior:rows"])

    own = type(getattr(detects["prior:rows"], "__self__"))  # noqa: B009
    assert own is not sys.modules["roadtorch.detectors.detector"].Detector
    assert sys.modules["roadtorch"] is before["roadtorch"]


def test_rates_are_those_behind_the_start(
    printed_by: PrintedBy, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def seconds(checkout: Path, line: str, jobs: int, folder: Path) -> float:
        return 2 + int(folder.name) / (10 * jobs)

    monkeypatch.setattr(bench_throughput, "make_inputs", lambda *_: None)
    monkeypatch.setattr(bench_throughput, "seconds", seconds)
    monkeypatch.setattr(bench_throughput, "ceiling", lambda *_: 25.0)

    printed = printed_by(bench_throughput, tmp_path, "--only", "infer", "--rounds", 2)

    assert printed.splitlines()[1:] == [
        f"| infer | {CHECKOUT.name} | 10.00 | 20.00 | 2.00 | 1.00 | 1.00 |",
        "| infer | two detectors alone |  | 25.00 |  |  | 1.25 |",
    ]


def test_a_process_that_only_detects_tells_its_rate(printed_by: PrintedBy, tmp_path: Path) -> None:
    write_picture(tmp_path / "pictures" / "a.png", render_scene(0, 48, 64))

    assert float(printed_by(bench_throughput, tmp_path, "--pictures", 2, "--alone")) > 0
