"""The benchmark: its stopwatch counts time once, its figures are kept, a stale page is found."""

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from roadtorch.detectors.catalogue import load_detector
from roadtorch.imaging import resize as working_size
from roadtorch.scenes.street import render_scene
from scripts import bench, bench_parts, bench_size
from scripts.bench_figures import (
    Figure,
    figure,
    merged,
    read_figures,
    stale,
    write_figures,
    written,
)
from scripts.bench_stages import Counter, bound_by, counted

SCRIPT = Path(bench.__file__)
ROOT = SCRIPT.parents[1]
PAGE = "# Time\n\n<!-- bench: detectors -->\n<!-- end -->\n\nThe end.\n"


Run = Callable[..., tuple[int, list[str]]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """``run("--check", page)``: the exit status and the lines printed, in this process."""

    def call(*arguments: object) -> tuple[int, list[str]]:
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, arguments)])
        status = bench.main()
        return status, capsys.readouterr().out.splitlines()

    return call


def made(command: str, *figures: Figure) -> list[Figure]:
    """Figures with what a run adds to them."""
    rest = {"rounds": 20, "date": "2026-01-02", "machine": "2 cores", "load": 0.1}
    return [one | rest | {"command": command} for one in figures]


def one_detector(value: float) -> list[Figure]:
    return made("a", figure("detectors", "fusion", "ms, 1 thread", value, "ms"))


def test_a_part_is_measured_kept_written_and_checked(tmp_path: Path, run: Run) -> None:
    kept, page = tmp_path / "figures.json", tmp_path / "page.md"
    page.write_text(PAGE.replace("detectors", "stages"))
    words = ["--only", "stages", "--threads", "1", "--json", str(kept)]

    status, _ = run(*words, "--rounds", 2, "--write", page)

    assert status == 0
    figures = {one["name"]: one for one in json.loads(kept.read_text())}
    assert all(figures[f"stages/{stage}/ms, 1 thread"]["value"] > 0 for stage in bench.STAGES)
    for one in figures.values():
        assert one["command"] == "python scripts/bench.py --only stages --threads 1"
        assert {"value", "unit", "date", "machine", "commit", "rounds"} <= one.keys()
    assert "\n| network | " in page.read_text()
    assert run("--check", page, "--json", kept) == (1, [f"{page}: no table of machine"])


def test_a_planted_stale_figure_is_found(tmp_path: Path, run: Run) -> None:
    kept, page = tmp_path / "figures.json", tmp_path / "page.md"
    write_figures(kept, one_detector(31.52))
    page.write_text(written(PAGE, read_figures(kept)))
    assert "| fusion | 31.5 |" in page.read_text()
    assert run("--check", page, "--json", kept) == (0, [])

    page.write_text(page.read_text().replace("31.5", "28.5"))
    status, told = run("--check", page, "--json", kept)

    assert status == 1
    assert told == [f"{page}: line 7: | fusion | 28.5 | (measured: | fusion | 31.5 |)"]


def test_a_table_that_the_page_lacks_is_told() -> None:
    other = made("b", figure("large", "fusion", "ms, 1 thread", 41.0, "ms"))
    figures = one_detector(31.5)

    assert stale(written(PAGE, figures), [*figures, *other]) == ["no table of large"]


def test_a_run_replaces_its_own_figures_where_they_stood() -> None:
    two = made("b", figure("large", "fusion", "ms, 1 thread", 41.0, "ms"))

    found = merged([*one_detector(31.5), *two], one_detector(25.0), "a")

    assert [one["value"] for one in found] == [25.0, 41.0]


def test_the_page_of_this_checkout_says_what_was_measured() -> None:
    page = (ROOT / "docs" / "performance.md").read_text("utf-8")

    assert stale(page, read_figures(bench.FIGURES)) == []


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--only", "stagse"), "stagse: give some of detectors, large"),
        (("--rounds", "0"), "0: give a whole number from 1 up"),
        (("--threads", "1,x"), "x: give a whole number from 1 up"),
    ],
)
def test_mistakes_are_told_without_a_traceback(
    arguments: tuple[str, ...], complaint: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["bench.py", *arguments])

    with pytest.raises(SystemExit) as left:
        bench.main()

    assert left.value.code == 2
    assert complaint in capsys.readouterr().err


def test_every_part_has_a_table_in_the_page() -> None:
    page = (ROOT / "docs" / "performance.md").read_text("utf-8")

    assert all(f"<!-- bench: {part} -->" in page for part in bench.part_names())


def test_every_detector_that_is_no_grid_is_in_a_part() -> None:
    image = render_scene(0, 48, 64).image
    quick = bench_parts.detects(bench_parts.quick_detectors(), image)

    everyone = {*quick, *bench_parts.SLOW, *bench_parts.GRID}

    assert {name for name in bench_parts.list_detectors() if "<" not in name} <= everyone


# --- stages -----------------------------------------------------------------------------


def test_the_stages_leave_out_little_of_detect_and_count_nothing_twice() -> None:
    image = render_scene(2).image
    detect = load_detector("fusion").detect
    detect(image)
    shares = []
    for _ in range(5):
        start = time.process_time()  # which other work on the machine does not touch
        times = bench.time_stages(detect, image, bench.STAGES, time.process_time)
        shares.append(times[bench.SUM] / 1000 / (time.process_time() - start))

    assert max(shares) <= 1
    assert statistics.median(shares) > 0.8


def test_the_stopwatch_is_taken_off_again_even_after_an_error() -> None:
    before = working_size.resized

    with pytest.raises(RuntimeError, match=r"no longer calls .*superpixels"):
        bench.time_stages(lambda image: None, torch.zeros(3, 16, 16))

    assert working_size.resized is before


def test_operations_and_bytes_are_those_of_the_formula() -> None:
    one, two = torch.ones(8, 16), torch.ones(16, 4)

    with Counter() as counter:
        (one.reshape(16, 8).reshape(8, 16) @ two).add(1)  # views are free

    assert counter.kernels == 2
    assert counter.operations == 2 * 8 * 16 * 4 + 8 * 4
    assert counter.bytes == 4 * (8 * 16 + 16 * 4 + 8 * 4 + 2 * 8 * 4)


def test_the_network_is_nearly_all_of_the_floating_point_operations() -> None:
    work = counted(render_scene(0, 240, 320).image)

    assert work["network"].operations > 0.5 * sum(one.operations for one in work.values())


@pytest.mark.parametrize(
    ("ms", "computing", "moving", "bound"),
    [(10, 6, 1, "compute"), (10, 1, 6, "memory"), (10, 1, 2, "overhead")],
)
def test_a_stage_is_bound_by_the_higher_floor_or_by_none(
    ms: float, computing: float, moving: float, bound: str
) -> None:
    assert bound_by(ms, computing, moving)[0] == bound


# --- size -------------------------------------------------------------------------------


def test_the_memory_of_a_large_picture_stays_below_24_bytes_a_pixel() -> None:
    peaks = []
    for megapixels in (0.5, 6.5):
        words = [sys.executable, bench_size.__file__, str(megapixels)]
        told = json.loads(subprocess.check_output(words, text=True).splitlines()[-1])
        peaks.append((told["pixels"], told["MiB"] * 2**20))

    (few, small), (many, large) = peaks
    assert (large - small) / (many - few) < 24
