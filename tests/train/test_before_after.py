"""The page at the end of a run that started from weights."""

import re
import shutil
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from roadtorch.base.errors import ConfigError, RoadtorchError
from roadtorch.cli.train import train as train_command
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.layout.weights import save_network
from roadtorch.run.memo import write_arrays
from roadtorch.testing.scenes import write_picture
from roadtorch.train.config import PictureTraining
from roadtorch.train.teachers import teacher_agreement
from tests.command import invoked
from tests.streets import scene
from tests.train.runs import PICTURES, training_of, write_config

NETWORK = PictureNetworkSettings(height=32, width=40, narrow=8, wide=8)
HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("start") / "first.safetensors"
    save_network(path, PictureNetwork(NETWORK), {})
    return path


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rendered streets with their road, as the set ``folder`` is laid out."""
    root = tmp_path_factory.mktemp("labelled")
    (root / "masks").mkdir()
    for seed in range(2):
        street = scene(seed, 60, 80)
        write_picture(root / "images" / f"s{seed}.png", street)
        mask = np.where(street.road.numpy(), 255, 0).astype(np.uint8)
        cv2.imwrite(str(root / "masks" / f"s{seed}.png"), mask)
    return root


run = partial(invoked, train_command)


def words(out: Path, images: Path, *more: object) -> list[object]:
    config = write_config(out.with_suffix(".toml"), PICTURES)
    quick = ("--set", "rounds.count=1", "--set", "rounds.start=continued")
    return ["--config", config, "--images", images, "--out", out, *quick, *more]


def test_a_run_from_weights_ends_with_a_page(
    streets: Path, kept: Path, start: Path, labelled: Path, tmp_path: Path
) -> None:
    more = ("--set", f"start={start}", "--labelled", f"folder:{labelled}")
    result = run(*words(tmp_path / "run", streets, "--prepared", kept / "pictures", *more))

    assert "before and after in" in result.output
    page = (tmp_path / "run" / "adaptation.html").read_text()
    assert page.count("data:image/jpeg;base64") == 5
    for text in (
        "The same 5 pictures",
        "All there are, the most changed first.",
        "agrees with the teacher on layout",
        "The teacher is the detector labeller",
        'alt="Mean loss of the epochs"',
        'alt="Trust before and after"',
        "folder",
        "default-src 'none'",
    ):
        assert text in page
    # With labels: F before and after, and the paired interval.
    assert re.search(r">before</th><td>.*>after</th><td>.*minus before</th>.* to ", page, re.S)
    assert "Nobody labelled these" not in page
    # It asks for nothing.
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)", page)
    assert "<script" not in page


def test_names_are_text_on_the_page_even_after_resuming(start: Path, tmp_path: Path) -> None:
    images = tmp_path / "footage"
    write_picture(images / "plain.png", scene(0, 60, 80))
    for name in (HOSTILE, "third"):
        shutil.copy(images / "plain.png", images / f"{name}.png")
    more = ("--set", f"start={start}", "--quiet")
    given = words(tmp_path / "run", images, *more)
    run(*given)
    page = tmp_path / "run" / "adaptation.html"
    before = page.read_text()
    assert "The same 3 pictures" in before
    assert HOSTILE not in before
    assert "&lt;img src=x onerror=alert(1)&gt;" in before

    page.unlink()
    run(*given)

    assert page.read_text().split("How it was made")[0] == before.split("How it was made")[0]


def test_a_run_from_new_weights_has_no_before(streets: Path, kept: Path, tmp_path: Path) -> None:
    run(*words(tmp_path / "run", streets, "--prepared", kept / "pictures"))
    assert not (tmp_path / "run" / "adaptation.html").exists()


@pytest.mark.parametrize("is_there", [True, False])
def test_labels_without_a_before_or_not_there_are_refused_before_anything_is_made(
    streets: Path, start: Path, labelled: Path, tmp_path: Path, is_there: bool
) -> None:
    root, begun = (labelled, ()) if is_there else (tmp_path / "none", ("--set", f"start={start}"))
    message = "--labelled: is for runs that start from weights" if is_there else "is not a folder"
    with pytest.raises(ConfigError if is_there else RoadtorchError, match=message):
        run(*words(tmp_path / "run", streets, "--labelled", f"folder:{root}", *begun))
    assert not (tmp_path / "run").exists()


def test_agreement_counts_the_pixels_where_the_teacher_is_sure(tmp_path: Path) -> None:
    training = training_of("pictures")
    assert isinstance(training, PictureTraining)
    network = PictureNetwork(NETWORK).eval()
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

    assert agreement.pictures == 2
    assert agreement.layout == pytest.approx(16 / 24)
    # Odds of nothing are 0.5, which is road: right in the last quarter without the ego car.
    assert agreement.road == pytest.approx(8 * 36 / (32 * 40))
