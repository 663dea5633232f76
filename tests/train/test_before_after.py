"""The page at the end of a run that started from weights."""

import re
import shutil
from pathlib import Path

import pytest
import torch

from roadtorch.cli.train import train_command
from roadtorch.layout.image_network import ImageNetwork, ImageNetworkSettings
from roadtorch.layout.weights import save_network
from roadtorch.run.memo import write_arrays
from roadtorch.testing.scenes import write_image
from roadtorch.train.config import ImageTraining
from roadtorch.train.teachers import teacher_agreement
from tests.command import invoke_command
from tests.streets import scene
from tests.train.runs import IMAGES, training_of, write_config

NETWORK = ImageNetworkSettings(height=32, width=40, narrow=8, wide=8)
HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("start") / "first.safetensors"
    save_network(path, ImageNetwork(NETWORK), {})
    return path


def test_a_run_from_weights_ends_with_a_page(start: Path, tmp_path: Path) -> None:
    images = tmp_path / "footage"
    write_image(images / "plain.png", scene(0, 60, 80))
    for name in (HOSTILE, "third"):
        shutil.copy(images / "plain.png", images / f"{name}.png")
    words = ["--config", write_config(tmp_path / "run.toml", IMAGES), "--images", images]
    words += ["--out", tmp_path / "run", "--set", f"initial_weights={start}"]

    result = invoke_command(train_command, *words)

    assert "before and after in" in result.output
    path = tmp_path / "run" / "adaptation.html"
    page = path.read_text()
    assert page.count("data:image/jpeg;base64") == 3
    for text in (
        *("Masks of 3 images", "agreement with the teacher labeller on layout"),
        *('alt="Mean loss of the epochs"', 'alt="Trust before and after', "default-src 'none'"),
        "&lt;img src=x onerror=alert(1)&gt;",
    ):
        assert text in page
    # It asks for nothing, and names are text.
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)", page)
    assert "<script" not in page
    assert HOSTILE not in page

    path.unlink()  # it is written again by resuming
    invoke_command(train_command, *words)
    assert path.read_text().split("<h2>Weights")[0] == page.split("<h2>Weights")[0]


def test_agreement_counts_the_pixels_where_the_teacher_is_sure(tmp_path: Path) -> None:
    training = training_of("images")
    assert isinstance(training, ImageTraining)
    network = ImageNetwork(NETWORK).eval()
    for weight in network.parameters():
        torch.nn.init.zeros_(weight)  # it says sky, and no road, nowhere more than elsewhere
    maps = torch.zeros(4, 32, 40, dtype=torch.uint8)
    maps[0, :16], maps[1, 16:24] = 255, 255  # sky; vertical; below, the teacher is in doubt
    maps[3, 24:] = 255  # road
    ego = torch.zeros(32, 40, dtype=torch.uint8)
    ego[:, 36:] = 255
    image = torch.zeros(3, 32, 40, dtype=torch.uint8)
    write_arrays(tmp_path / "a.npz", {"image": image, "maps": maps, "ego": ego})

    agreement = teacher_agreement(network, [tmp_path / "a.npz"] * 2, training)

    assert agreement.images == 2
    assert agreement.layout == pytest.approx(16 / 24)
    # Odds of nothing are 0.5, which is road: right in the last quarter without the ego car.
    assert agreement.road == pytest.approx(8 * 36 / (32 * 40))
