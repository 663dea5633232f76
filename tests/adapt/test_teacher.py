"""What one look misses, the looks at the same place before and after it say."""

from pathlib import Path

import pytest
import torch

from roadtorch.adapt.frames import keep_frames
from roadtorch.adapt.teacher import write_taught
from roadtorch.io.image import write_jpeg
from roadtorch.layout.classes import CLASSES
from roadtorch.runtime.shipped_configs import config_file
from roadtorch.scenes.street import render_scene
from roadtorch.settings import parse_assignments, read_settings_file
from roadtorch.train.config import PictureTraining, build_training
from roadtorch.train.prepared import from_bytes, read_arrays


@pytest.fixture
def training() -> PictureTraining:
    quick = parse_assignments(["teacher.views=one", "teacher.detector=labeller"])
    values = read_settings_file(config_file("adapt"))
    values["teacher"] |= quick["teacher"]
    training = build_training(values)
    assert isinstance(training, PictureTraining)
    return training


def roads(folder: Path) -> torch.Tensor:
    files = sorted(folder.rglob("*.npz"))
    return torch.stack([from_bytes(read_arrays(file, "maps")["maps"][CLASSES]) for file in files])


def test_looks_at_one_place_become_alike_and_other_pictures_stay_as_they_are(
    training: PictureTraining, tmp_path: Path
) -> None:
    (tmp_path / "drive").mkdir()
    street, generator = render_scene(1, 120, 160).image, torch.Generator().manual_seed(0)
    for number in range(4):
        noise = 0.05 * torch.randn(street.shape, generator=generator)
        write_jpeg(tmp_path / f"drive/{number}.jpg", (street + noise).clamp(0, 1))
    write_jpeg(tmp_path / "drive/4.jpg", render_scene(2, 120, 160).image)
    frames = keep_frames([str(tmp_path / "drive")], tmp_path / "frames", 10, quiet=True)
    looks, prepared = tmp_path / "looks", tmp_path / "prepared"

    assert write_taught(frames, looks, prepared, training, quiet=True) is None

    before, after = roads(looks), roads(prepared)
    assert after[:4].var(0).mean() < 0.2 * before[:4].var(0).mean()
    assert torch.allclose(after[4], before[4], atol=1 / 255)
    files = sorted(looks.rglob("*.npz"))
    one, other = (
        read_arrays(at, "image", "ego") for at in (files[0], next(prepared.rglob(files[0].name)))
    )
    assert all(one[name].equal(other[name]) for name in one)
