"""Training with human corrections: they replace the targets, and the weights record them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.annotate.session import make_import_event
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.cli.train import train_command
from roadtorch.data.corrections import Correction, EventLog, LogHeader, log_path
from roadtorch.layout.weights import count_corrected_images, read_correction_runs
from roadtorch.train.run import Outcome, TrainingRequest, make_recipe, train
from roadtorch.train.targets import Targets
from roadtorch.train.whole_images import corrected_targets, reweight
from tests.command import invoke_command
from tests.train.conftest import Trained
from tests.train.runs import IMAGES, training_of, write_config

UNTOUCHED, ROAD, NOT_ROAD, VOID, SKY = range(5)


def correction(labels: np.ndarray, image: Path = Path("street.png")) -> Correction:
    return Correction(image, image.name, labels.astype(np.uint8), False, 1.0, 1, Path("log"))


def quarters(height: int = 8, width: int = 8) -> np.ndarray:
    """Return labels: above sky and untouched, below road and not road."""
    labels = np.full((height, width), UNTOUCHED)
    labels[: height // 2, : width // 2] = SKY
    labels[height // 2 :, : width // 2] = ROAD
    labels[height // 2 :, width // 2 :] = NOT_ROAD
    return labels


# --- targets -------------------------------------------------------------------------------


def machine(size: int = 8) -> Targets:
    """Return targets: vertical, half road, all ego, each with weight 0.25."""
    layout = torch.zeros(1, 3, size, size)
    layout[:, 1] = 1
    quarter, half, ones = (torch.full((1, 1, size, size), value) for value in (0.25, 0.5, 1.0))
    return Targets(layout, quarter, half, quarter, ones, quarter)


def planes(labels: np.ndarray) -> torch.Tensor:
    """Return the correction's planes at eight by eight cells."""
    recipe = make_recipe(training_of("images", "network.height=32", "network.width=32"))
    large = labels.repeat(8, 0).repeat(8, 1)
    return recipe.correct({}, correction(large))["planes"][None, :, ::4, ::4] / 255


def test_what_was_said_replaces_the_machines_target_and_has_its_weight() -> None:
    targets = corrected_targets(machine(), planes(quarters()), 3.0)

    assert targets.road[0, 0, 4:].tolist() == [[1, 1, 1, 1, 0, 0, 0, 0]] * 4
    assert targets.road_weight[0, 0, 4:].eq(3).all()
    assert targets.road[0, 0, :4, :4].eq(0).all()  # sky is no road
    assert targets.road[0, 0, :4, 4:].eq(0.5).all()
    assert targets.road_weight[0, 0, :4, 4:].eq(0.25).all()
    assert targets.layout[0, 0, :4, :4].eq(1).all()
    assert targets.layout[0, 2, 4:, :4].eq(1).all()  # road is horizontal
    assert targets.layout[0, 1, 4:, 4:].eq(1).all()  # "not road" says nothing of the layout
    assert targets.ego[0, 0, 4:, :4].eq(0).all()
    assert targets.ego[0, 0, 4:, 4:].eq(1).all()


def test_void_counts_for_nothing_and_nothing_said_changes_nothing() -> None:
    labels = quarters()
    labels[4:, :4] = VOID
    targets = corrected_targets(machine(), planes(labels), 1.0)
    assert targets.road_weight[0, 0, 4:, :4].eq(0).all()
    assert targets.layout_weight[0, 0, 4:, :4].eq(0).all()

    unchanged = corrected_targets(machine(), planes(quarters() * 0), 5.0)
    assert all(map(torch.equal, unchanged, machine()))


def test_corrected_images_get_their_share_of_the_visits() -> None:
    weights, corrected = torch.tensor([1.0, 3.0, 2.0, 2.0]), torch.tensor([1, 0, 0, 1]).bool()

    moved = reweight(weights, corrected, 0.7)

    assert float(moved[corrected].sum() / moved.sum()) == pytest.approx(0.7)
    assert float(moved[3] / moved[0]) == pytest.approx(2)
    assert torch.equal(reweight(weights, corrected | True, 0.7), weights)
    assert torch.equal(reweight(weights, corrected & False, 0.7), weights)


# --- runs ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def street(streets: Path) -> Correction:
    return correction(quarters(60, 80), streets / "street_0.png")


@pytest.fixture(scope="module")
def run(trained: Trained, street: Correction) -> Outcome:
    return trained("images", out="corrected", corrections=[street])


def test_a_run_paces_its_steps_by_the_corrected_images(
    trained: Trained, run: Outcome, street: Correction
) -> None:
    """Check that one corrected image and a huge half-rate count hardly change the weights."""
    slow = trained("images", "corrections.half_rate_images=1e6", out="slow", corrections=[street])
    still = trained("images", "descent.learning_rate=1e-12", out="still", corrections=[street])
    slowly, fast, start = (
        torch.load(Path(end.weights or "").with_name("checkpoint.pt"), weights_only=True)["network"]
        for end in (slow, run, still)
    )
    learned = [name for name in start if "running" not in name]  # but for statistics of images
    for name in learned:
        torch.testing.assert_close(slowly[name], start[name], atol=1e-6, rtol=0)
    assert any(not fast[name].allclose(start[name]) for name in learned)


def test_weights_say_that_people_corrected_images(run: Outcome) -> None:
    weights = run.weights
    assert weights is not None
    (summary,) = read_correction_runs(weights)
    assert (summary["images"], summary["pixels"]) == (1, 3 * 60 * 80 // 4)
    assert "not label-free" in weights.with_suffix(".md").read_text()
    assert count_corrected_images({"weights": {"file": str(weights)}}) == 1
    assert json.loads((weights.parent / "run.json").read_text())["corrections"] == summary


def test_what_starts_there_is_not_label_free(trained: Trained, run: Outcome) -> None:
    first = run.weights
    assert first
    second = trained(
        "images", f"initial_weights={first}", "stopping.epochs=1", out="second"
    ).weights
    assert second
    assert read_correction_runs(second) == read_correction_runs(first) != []


def test_the_command_reads_what_annotate_kept(streets: Path, cache: Path, tmp_path: Path) -> None:
    name, logs = "street_1.png", tmp_path / "corrections"
    head = LogHeader(image=f"elsewhere/{name}", height=60, width=80)
    EventLog(log_path(logs, name), head).add(make_import_event(quarters(60, 80).astype(np.uint8)))
    config = write_config(tmp_path / "train.toml", IMAGES)
    words = ["--config", config, "--images", streets, "--out", tmp_path / "run", "--quiet"]
    words += ["--corrections", logs, "--corrected-images", streets]

    result = invoke_command(train_command, *words)

    assert result.exit_code == 0, result.output
    (summary,) = read_correction_runs(tmp_path / "run" / "weights.safetensors")
    assert summary["images"] == 1


def test_other_corrections_are_refused(
    run: Outcome, street: Correction, streets: Path, cache: Path, tmp_path: Path
) -> None:
    assert run.weights
    request = TrainingRequest(str(streets), run.weights.parent, cache / "images", quiet=True)
    for kind, corrections, error, message in (
        ("images", [], ConfigError, "other corrections"),
        ("patches", [street], ConfigError, "--corrections: are for trainings of the kind images"),
        ("images", [correction(quarters(), tmp_path / "x.png")], InputError, "is not among"),
        ("images", [correction(quarters(), street.image)], InputError, "changed its size"),
    ):
        with pytest.raises(error, match=message):
            train(training_of(kind), replace(request, corrections=corrections))
