"""Fine-tuning on masks: held-out images decide when it stops, and score it."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from click.testing import CliRunner, Result
from torch import Tensor

from roadtorch.cli.train import train_command
from roadtorch.layout.weights import read_correction_runs
from roadtorch.testing.scenes import ROAD
from roadtorch.train.augmentation import GeometryAugmentation, sample_affine
from roadtorch.train.config import HeadWeights
from roadtorch.train.recordings import select_held_out
from roadtorch.train.teachers import Targets
from roadtorch.train.training_loop import make_generator
from roadtorch.train.whole_images import target_loss
from tests.streets import scene
from tests.train.runs import IMAGES, rows_of, write_config

NAMES = [f"{drive}_{number:02d}.png" for drive in "abc" for number in range(4)]


@pytest.mark.parametrize(
    ("names", "fraction", "expected"),
    [
        (NAMES[:11], 0.3, NAMES[8:11]),  # the smallest recording
        (NAMES, 0.35, NAMES[:4]),  # the first of equal ones
        (NAMES, 0.7, NAMES[:8]),
        (NAMES, 0.1, NAMES[-2:]),  # each is too large
        (["a.png", "b.png", "c.png"], 0.4, ["b.png", "c.png"]),  # no recordings
        (NAMES[:2], 0.1, [NAMES[1]]),
        (NAMES[:1], 0.1, []),
        (NAMES, 0.0, []),
    ],
)
def test_whole_recordings_are_held_out(
    names: list[str], fraction: float, expected: list[str]
) -> None:
    assert select_held_out(names[::-1], fraction, "_") == expected


def test_dice_is_one_minus_the_overlap_of_what_counts() -> None:
    scores, road = torch.full((1, 5, 2, 4), -30.0), torch.zeros(1, 1, 2, 4)
    scores[:, 3, :, :2], road[..., 1:3] = 30.0, 1.0
    weight = torch.ones_like(road)
    weight[..., 3] = 0  # void
    none = torch.zeros_like(road)
    targets = Targets(none.repeat(1, 3, 1, 1), none, road, weight, none, none)

    def loss(dice: float) -> Tensor:
        return target_loss(scores, targets, HeadWeights(road=0, dice=dice))

    assert float(loss(0.0)) == 0
    assert float(loss(2.0)) == pytest.approx(2 * (1 - 2 * 2 / (4 + 4)))


@pytest.mark.parametrize(("mirror", "signs"), [(0.0, {1}), (1.0, {-1}), (0.5, {-1, 1})])
def test_a_fraction_of_the_images_is_mirrored(mirror: float, signs: set[int]) -> None:
    geometry = GeometryAugmentation(mirror=mirror)
    maps = sample_affine(40, (32, 40), geometry, make_generator(0))
    assert set(maps[:, 0, 0].sign().int().tolist()) == signs


# --- the command ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def masks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the road of the images ``streets``, 0 and 1, as many programs do."""
    folder = tmp_path_factory.mktemp("masks")
    for seed in range(5):
        road = scene(seed, 60, 80).classes.numpy() == ROAD
        cv2.imwrite(str(folder / f"street_{seed}_mask.png"), road.astype(np.uint8))
    return folder


def train(out: Path, masks: Path, streets: Path, cache: Path, *words: object) -> Result:
    config = write_config(out.parent / "train.toml", IMAGES)
    arguments = ["--config", config, "--masks", masks, "--images", streets, "--out", out, *words]
    arguments += ["--prepared", cache / "images", "--set", "corrections.held_out=0.2"]
    return CliRunner().invoke(train_command, [str(word) for word in arguments])


def test_masks_train_and_the_held_out_image_scores(
    masks: Path, streets: Path, cache: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    result = train(out, masks, streets, cache)

    assert result.exit_code == 0, result.output
    first, *_, last = result.stderr.splitlines()
    assert first.startswith("roadtorch: 5 of 5 images have a mask; road is 1 (")
    assert last == (
        f"roadtorch: to use it: roadtorch infer {streets} "
        f"--set weights.file={out}/weights.safetensors --out roads"
    )
    rows = (out / "images.csv").read_text().splitlines()
    assert [row.endswith(",held out") for row in rows] == [False] * 5 + [True]
    assert all(0 <= float(row["held_out_f"]) <= 1 for row in rows_of(out))
    (summary,) = read_correction_runs(out / "weights.safetensors")
    assert summary["images"] == 5
