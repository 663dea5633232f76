"""The benchmark: what it prints and writes, and that its stopwatch counts time once."""

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from roadtorch import working_size
from roadtorch.detectors.catalogue import load_detector
from roadtorch.scenes import render_scene, write_picture
from scripts import bench

SCRIPT = Path(bench.__file__)


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=120)


def test_every_stage_and_both_ratios_are_printed_and_written(tmp_path: Path) -> None:
    picture, figures = tmp_path / "street.png", tmp_path / "figures.json"
    write_picture(picture, render_scene(1, 48, 64))

    done = run(
        *("--picture", picture, "--sizes", "64x48", "--rounds", 2, "--threads", 1),
        *("--json", figures),
    )

    assert done.returncode == 0, done.stderr
    written = json.loads(figures.read_text())
    assert written["machine"]["torch"] == torch.__version__
    assert written["machine"]["torch threads"] == 1
    size = written["sizes"]["64x48"]
    assert len(size["rounds"]) == 2
    assert all(times[stage] > 0 for times in size["rounds"] for stage in bench.STAGES)
    for name, (over, under) in bench.RATIOS.items():
        each = [times[over] / times[under] for times in size["rounds"]]
        assert size["ratios"][name]["median"] == pytest.approx(statistics.median(each))
        fastest = [min(times[one] for times in size["rounds"]) for one in (over, under)]
        assert size["ratios"][name]["fastest"] == pytest.approx(fastest[0] / fastest[1])
    for name in (*size["ms"], *size["ratios"]):
        assert f"\n| {name} | " in done.stdout


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--sizes", "640"), "640: give sizes from 16x16 up"),
        (("--sizes", "8x8"), "8x8: give sizes from 16x16 up"),
        (("--rounds", "0"), "0: give a whole number from 1 up"),
        (("--picture", "missing.png"), "missing.png: does not exist"),
    ],
)
def test_mistakes_are_told_without_a_traceback(
    arguments: tuple[str, ...], complaint: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["bench.py", "--threads", "2", *arguments])

    with pytest.raises(SystemExit) as left:
        bench.main()

    assert left.value.code == 2
    assert complaint in capsys.readouterr().err


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
