"""A network that became too timid, or too bold, is brought back to what the teacher's masks say."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from roadtorch import load_detector
from roadtorch.adapt.adapt import write_shifted
from roadtorch.adapt.verdict import fitted_bias, judged_half
from roadtorch.evaluation.metrics import Decisions, f_measure
from roadtorch.io.image import write_jpeg
from roadtorch.layout.weights import weights_path
from roadtorch.runtime.shipped_configs import config_file
from roadtorch.scenes.street import render_scene
from roadtorch.settings import read_settings_file
from roadtorch.sources.pictures import Picture, find_images
from roadtorch.train.config import PictureTraining, build_training
from roadtorch.train.prepared import name_of, to_bytes, write_arrays

SHIPPED = weights_path("backbone-free")


@pytest.fixture
def training() -> PictureTraining:
    training = build_training(read_settings_file(config_file("adapt")))
    assert isinstance(training, PictureTraining)
    return training


@pytest.fixture
def frames(tmp_path: Path) -> list[Picture]:
    """Three streets, and in PREPARED what `fusion` says of them, as if it were the teacher."""
    teacher = load_detector("fusion")
    for number in range(3):
        write_jpeg(tmp_path / f"{number}.jpg", render_scene(number, 120, 160).image)
    pictures = find_images([str(tmp_path / "*.jpg")])
    for picture in pictures:
        road = teacher.detect(picture.read()).mask.float()[None]
        layout = torch.cat([torch.zeros(2, 120, 160), torch.ones(1, 120, 160)])
        arrays = {"maps": to_bytes(torch.cat([layout, road])), "ego": to_bytes(0 * road[0])}
        (tmp_path / "prepared").mkdir(exist_ok=True)
        write_arrays(tmp_path / "prepared" / f"{name_of(picture)}.npz", arrays)
    return pictures


def f_of(counts: Tensor) -> float:
    return float(f_measure(Decisions(*counts.sum(0))))


@pytest.mark.parametrize("shift", [-2.0, 2.0], ids=["timid", "bold"])
def test_the_bias_undoes_what_shifted_the_road(
    shift: float, frames: list[Picture], training: PictureTraining, tmp_path: Path
) -> None:
    prepared, shifted, mended = (tmp_path / name for name in ("prepared", "s.file", "m.file"))
    write_shifted(SHIPPED, shifted, shift)

    bias = fitted_bias(frames, shifted, prepared, training, quiet=True)
    write_shifted(shifted, mended, bias)

    assert bias == pytest.approx(-shift, abs=1)
    judged = judged_half(frames, (shifted, mended, mended), prepared, training, quiet=True)
    assert f_of(judged.after) > f_of(judged.before)
    assert f_of(judged.after) > 0.97


def test_without_a_frame_that_can_tell_nothing_is_shifted(
    frames: list[Picture], training: PictureTraining, tmp_path: Path
) -> None:
    assert fitted_bias(frames, SHIPPED, tmp_path / "nothing", training, quiet=True) == 0
