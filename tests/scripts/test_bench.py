"""The benchmarks: a short run of each, and that two checkouts stay apart."""

import sys
from pathlib import Path

import pytest

from scripts import bench

CHECKOUT = Path(__file__).resolve().parents[2]


def test_contestants_take_turns_and_a_ratio_is_that_of_the_rounds() -> None:
    called: list[str] = []
    calls = {name: lambda name=name: called.append(name) for name in "ab"}

    times = bench.interleaved(calls, 2)

    assert {name: len(values) for name, values in times.items()} == {"a": 2, "b": 2}
    assert "".join(called) == "abba" * 2
    assert bench.ratio([2.0, 1.0, 9.0], [1.0, 1.0, 3.0]) == 2.0


def test_rates_are_those_behind_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def seconds(checkout: Path, line: str, jobs: int, folder: Path) -> float:
        return 2 + int(folder.name) / (10 * jobs) * (0.8 if line == bench.DETECT else 1)

    monkeypatch.setattr(bench, "make_inputs", lambda *_: None)
    monkeypatch.setattr(bench, "seconds", seconds)

    _, _, detect, infer = bench.rates(CHECKOUT, [CHECKOUT], 2, ["infer"], {})

    assert detect == f"| detect | {CHECKOUT.name} | 12.5 | 25.0 | 2.00 | 1.00 |"
    assert infer == f"| infer | {CHECKOUT.name} | 10.0 | 20.0 | 2.00 | 0.80 |"


def test_runtimes_of_two_checkouts_have_their_stages(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    records: dict[str, float] = {}
    monkeypatch.setattr(bench, "keep_records", lambda *words: records.update(words[-1]))
    monkeypatch.setattr(bench, "LARGE_AND_SMALL", ("fusion",))
    monkeypatch.setattr(bench, "RUNTIMES", ("torch",))
    package = sys.modules["roadtorch"]

    size = ("--size", "64", "48", "--rounds", "1", "--write")
    bench.main(["--runtimes", "--against", str(CHECKOUT), *size])

    assert sys.modules["roadtorch"] is package
    rows = [line.split(" | ")[0] for line in capsys.readouterr().out.splitlines()[2:]]
    assert rows == ["| fusion, before", "| fusion:torch", "| LRASPP:torch"]
    row = {name: records[f"runtimes.fusion:torch.{name}"] for name in bench.RUNTIME_COLUMNS}
    assert all(milliseconds > 0 for milliseconds in row.values())
    assert sum(row[stage] for stage in bench.STAGES) <= row["detect"]
