import json
from pathlib import Path

import pytest
import torch

from roadtorch.scenes.street import render_scene, write_picture
from scripts import scale


def test_stages_are_measured_and_the_table_is_their_sum(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    threads, measured = torch.get_num_threads(), tmp_path / "measured.json"
    for seed in range(3):
        write_picture(tmp_path / "in" / f"{seed}.png", render_scene(seed, 48, 64))
    try:
        words = ["measure", str(tmp_path / "in"), "--detector", "cpf", "--json", str(measured)]
        scale.main(words)
    finally:
        torch.set_num_threads(threads)

    found = json.loads(measured.read_text())

    assert set(found) == set(scale.STAGES)
    assert all(ms > 0 for ms in found.values())
    assert json.loads(capsys.readouterr().out) == found


def test_the_table_is_arithmetic() -> None:
    measured = {"read": 4.0, "detect": 30.0, "write": 2.0, "decode": 1.0}

    lines = scale.table(measured, price=0.5, rate=10.0, every=10).splitlines()

    assert lines[2] == "| a million pictures | 10.0 | 5.00 |"
    assert lines[3] == "| 1,000 hours of video at 10/s, every frame | 330.0 | 165.00 |"
    assert lines[4] == "| 1,000 hours of video at 10/s, every 10th frame | 42.0 | 21.00 |"
