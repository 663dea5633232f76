"""The benchmarks: a short run of each, and that two checkouts stay apart."""

import json
import sys
from pathlib import Path

import pytest

from roadtorch.scenes.street import render_scene, write_picture
from scripts import bench, bench_against, bench_throughput
from tests.scripts.conftest import PrintedBy

CHECKOUT = Path(__file__).resolve().parents[2]


def test_detectors_stand_beside_their_peers_and_are_kept(
    printed_by: PrintedBy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench, "KEPT", tmp_path / "kept.json")

    said = printed_by(bench, "fusion", "--size", "64x48", "--rounds", 1, "--write")

    assert [line.split("|")[1].strip() for line in said.splitlines()[2:4]] == [
        "fusion",
        bench.LRASPP,
    ]
    kept = json.loads(bench.KEPT.read_text())["values"]
    assert f"| {kept['bench.fusion.ms']:.1f} | {kept['bench.fusion.of_lraspp']:.2f} |" in said


def test_contestants_take_turns_and_a_ratio_is_that_of_the_rounds() -> None:
    called: list[str] = []
    calls = {name: lambda name=name: called.append(name) for name in "ab"}

    times = bench.interleaved(calls, rounds=2)

    assert {name: len(values) for name, values in times.items()} == {"a": 2, "b": 2}
    assert bench.ratio([2.0, 1.0, 9.0], [1.0, 1.0, 3.0]) == 2.0
    assert called.count("a") == called.count("b")


def test_a_checkout_has_its_own_package_and_others_stay_loaded() -> None:
    before = dict(sys.modules)

    found = bench_against.detectors_of(CHECKOUT, ["prior:rows"])

    own = type(getattr(found["prior:rows"], "__self__"))  # noqa: B009
    assert own is not sys.modules["roadtorch.detector"].Detector
    assert sys.modules["roadtorch"] is before["roadtorch"]


def test_throughput_is_told_beside_what_bounds_it(printed_by: PrintedBy, tmp_path: Path) -> None:
    for number in range(2):
        write_picture(tmp_path / f"{number}.png", render_scene(number, 48, 64))

    said = printed_by(
        bench_throughput,
        *(tmp_path, "--pictures", 2, "--rounds", 1, "--workers", 1, "--detector", "prior:rows"),
    )

    assert set(json.loads(said)) == {"detect", "read and write", "infer", "share"}
