"""Fine-tuning on masks: held-out images decide when it stops, and score it."""

import base64
import io
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from roadtorch.cli.train import train_command
from roadtorch.data.label_images import LabelPixels
from roadtorch.data.masks import Mask
from roadtorch.evaluation.report.montage import TILE_WIDTH, VERMILLION
from roadtorch.evaluation.result import Comparison, Difference, Interval
from roadtorch.layout.backbone_network import Backbone, BackboneNetwork
from roadtorch.layout.pretrained import load_imagenet_weights
from roadtorch.layout.weights import load_network, read_correction_runs
from roadtorch.testing.scenes import write_image
from roadtorch.train.comparison_page import describe_gain
from roadtorch.train.recordings import select_held_out
from roadtorch.train.run import Outcome
from tests.command import invoke_command
from tests.networks import write_random_network, write_wheel
from tests.streets import scene
from tests.train.conftest import Trained
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


def test_the_weights_of_the_best_epoch_are_kept_and_training_stops_after_it(
    trained: Trained, streets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = partial(LabelPixels, np.ones((60, 80), np.uint8))
    masks = [Mask(path, read, (1,), ()) for path in sorted(streets.iterdir())]
    settings = ("corrections.held_out=0.2", "stopping.patience=2", "stopping.epochs={}")

    def run(scores: Sequence[float], epochs: int) -> tuple[Outcome, list[Tensor]]:
        values = iter(scores)
        monkeypatch.setattr("roadtorch.train.run.held_out_f", lambda *_, **__: next(values))
        changes = [setting.format(epochs) for setting in settings]
        outcome = trained("images", *changes, out=f"best-{epochs}", corrections=masks)
        assert outcome.weights
        return outcome, list(load_network(outcome.weights).state_dict().values())

    outcome, weights = run([0.5, 0.9, 0.7, 0.8], 8)
    assert [labels.image.name for labels in outcome.held_out] == ["street_4.png"]
    assert outcome.weights
    assert len(rows_of(outcome.weights.parent)) == 4
    assert all(map(torch.equal, weights, run([], 8)[1]))  # resumed after the end
    assert all(map(torch.equal, weights, run([0.1, 0.2], 2)[1]))
    assert not all(map(torch.equal, weights, run([0.2, 0.1, 0.3], 3)[1]))


# --- the verdict ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("low", "images", "start", "end"),
    [
        (0.01, 5, "better: on 5", "(95 % +0.010 to +0.030); prior:rows 0.600"),
        (-0.01, 5, "undecided: on 5", "; prior:rows 0.600; add masks to decide"),
        (-0.03, 9, "worse: on 9", "; prior:rows 0.600; use fusion as it is"),
        (0.01, 4, "undecided: on 4", "below 5); prior:rows 0.600; add masks to decide"),
    ],
)
def test_the_interval_decides_in_words(low: float, images: int, start: str, end: str) -> None:
    values = {"before": 0.7, "after": 0.72, "prior:rows": 0.6}
    scores = {name: {"f_mask": value} for name, value in values.items()}
    change = {"after": {"f_mask": Difference(0.02, Interval(low, low + 0.02))}}
    comparison = Comparison("before", change)
    run: Any = SimpleNamespace(images=images, headlines=scores, comparison=comparison)
    text = f"{start} held-out images F of the mask 0.700 before, 0.720 after, +0.020 "
    assert re.fullmatch(f"{re.escape(text)}.*{re.escape(end)}", describe_gain(run))


# --- the command ------------------------------------------------------------------------

HOSTILE = "<img src=x onerror=alert(1)>"


def test_a_run_from_weights_ends_with_a_page_of_masks_before_and_after(tmp_path: Path) -> None:
    start, images = write_random_network(tmp_path / "first.safetensors", 0), tmp_path / "footage"
    for name in ("plain", HOSTILE, "third"):
        write_image(images / f"{name}.png", scene(0, 60, 80))
    words = ["--config", write_config(tmp_path / "run.toml", IMAGES), "--images", images]
    words += ["--out", tmp_path / "run", "--set", f"initial_weights={start}"]

    result = invoke_command(train_command, *words)

    assert "before and after in" in result.output
    page = (path := tmp_path / "run" / "adaptation.html").read_text()
    assert page.count("data:image/jpeg;base64") == 3
    for text in (
        "Masks of 3 images",
        'alt="Mean loss of the epochs"',
        'alt="Trust before and after',
        "default-src 'none'",
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


def test_a_run_from_the_weights_of_imagenet_begins_with_them(
    streets: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_wheel(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    words = ["--config", write_config(tmp_path / "run.toml", IMAGES), "--images", streets]
    words += ["--out", tmp_path / "run", "--set", "initial_weights=imagenet"]
    words += ["--set", "descent.learning_rate=1e-9"]

    invoke_command(train_command, *words)

    assert not (tmp_path / "run/adaptation.html").exists()  # there is nothing to compare with
    network = load_network(tmp_path / "run/weights.safetensors")
    assert isinstance(network, BackboneNetwork)
    load_imagenet_weights(expected := Backbone())
    for name, weight in expected.state_dict().items():
        begun = network.backbone.state_dict()[name]
        torch.testing.assert_close(begun, weight, atol=1e-5, rtol=1e-3)  # in half precision


def test_masks_train_and_the_held_out_image_scores(
    streets: Path, cache: Path, tmp_path: Path
) -> None:
    masks, out = tmp_path / "masks", tmp_path / "run"
    masks.mkdir()
    for seed in range(5):
        road = scene(seed, 60, 80).road.numpy().astype(np.uint8)
        cv2.imwrite(str(masks / f"street_{seed}_mask.png"), road)
    config = write_config(tmp_path / "train.toml", IMAGES)
    words = ["--config", config, "--masks", masks, "--images", streets, "--out", out]
    words += ["--set", "corrections.held_out=0.2"]

    result = invoke_command(train_command, *words)

    assert result.exit_code == 0, result.output
    first, *_, score, last = result.stderr.splitlines()
    assert first.startswith("roadtorch: 5 of 5 images have a mask; road is 1 (")
    assert score.startswith("roadtorch: undecided: on 1 held-out image F of the mask 0.")
    use = f"infer {streets} --set weights.file={out}/weights.safetensors --out {out}/roads"
    assert last == f"roadtorch: to use it: roadtorch {use}"
    page = (out / "adaptation.html").read_text()
    for text in (
        *(f"<strong>{score.removeprefix('roadtorch: ')}.", f"To use it: <code>roadtorch {use}<"),
        *("<h2>Held-out images", ">prior:rows<", 'alt="F on held-out images by epoch"', "; F 0."),
    ):
        assert text in page
    assert "no labels" not in page
    (montage,) = re.findall(r"data:image/jpeg;base64,([^\"]*)", page)
    before = np.asarray(Image.open(io.BytesIO(base64.b64decode(montage))))[:, :TILE_WIDTH]
    assert (np.abs(before.astype(int) - VERMILLION).max(2) < 40).sum() > 100  # the true road
    rows = (out / "images.csv").read_text().splitlines()
    assert [row.endswith(",held out") for row in rows] == [False] * 5 + [True]
    (summary,) = read_correction_runs(out / "weights.safetensors")
    assert summary["images"] == 5
