"""The page at the end of a run that started from weights."""

import re
import shutil
from pathlib import Path

import pytest
import torch

from roadtorch.cli.train import train_command
from roadtorch.layout.image_network import ImageNetwork, ImageNetworkSettings
from roadtorch.layout.weights import save_network
from roadtorch.testing.scenes import write_image
from tests.command import invoke_command
from tests.streets import scene
from tests.train.runs import IMAGES, write_config

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
        *(
            "Masks of 3 images",
            'alt="Mean loss of the epochs"',
            'alt="Trust before and after',
            "default-src 'none'",
        ),
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
