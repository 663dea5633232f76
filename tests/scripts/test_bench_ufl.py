"""The benchmark of ``ufl``: what it prints and writes, and that its stages are most of detect."""

import json
import statistics
import time
from pathlib import Path

from roadtorch.detectors.catalogue import load_detector
from roadtorch.scenes.street import render_scene
from scripts import bench_ufl
from scripts.bench import SUM, time_stages
from tests.scripts.conftest import PrintedBy


def test_every_stage_and_every_rate_is_printed_and_written(
    tmp_path: Path, printed_by: PrintedBy
) -> None:
    figures = tmp_path / "figures.json"
    words = ["--sizes", "32x24", "--rounds", "1", "--threads", "1", "--json", str(figures)]

    printed = printed_by(bench_ufl, *words)

    size = json.loads(figures.read_text())["sizes"]["32x24"]
    assert all(size["rounds"][0][stage] > 0 for stage in bench_ufl.STAGES)
    patches = 115 * 155  # of 160x120, whatever the size of the picture
    assert size["operations"]["K-means"] == 10 * 2 * patches * 200 * 108
    for name in (*size["ms"], *size["ratios"], *size["operations"]):
        assert f"\n| {name} | " in printed


def test_the_stages_leave_out_little_of_detect() -> None:
    image = render_scene(2, 120, 160).image
    detect = load_detector("ufl").detect
    detect(image)
    shares = []
    for _ in range(3):
        start = time.process_time()
        times = time_stages(detect, image, bench_ufl.STAGES, time.process_time)
        shares.append(times[SUM] / 1000 / (time.process_time() - start))

    assert max(shares) <= 1
    assert statistics.median(shares) > 0.8
