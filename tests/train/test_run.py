"""Whole runs: finished, interrupted, resumed; the moving average of the weights."""

import json
import math
import signal
from pathlib import Path

import pytest
import torch

from roadtorch.base.atomic import RESULTS_FILE
from roadtorch.base.errors import DivergedError, ExitCode
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.weights import load_network, read_origin, save_network
from roadtorch.train import training_loop
from roadtorch.train.config import Training
from roadtorch.train.run import Outcome, TrainingRequest, make_network, train
from roadtorch.train.training_loop import Loop
from tests.command import Call
from tests.networks import SMALL_BACKBONE
from tests.train.conftest import Trained
from tests.train.runs import PATCHES, interrupt_after, rows_of, training_of, write_config


def folder_of(outcome: Outcome) -> Path:
    assert outcome.weights is not None
    return outcome.weights.parent


WHOLE = {"patches": "descent.momentum=0.9", "images": "descent.ema=0.7"}


@pytest.fixture(scope="module")
def whole(trained: Trained) -> dict[str, Path]:
    """Return the folders of two uninterrupted runs."""
    return {kind: folder_of(trained(kind, change)) for kind, change in WHOLE.items()}


# --- whole runs ------------------------------------------------------------------------------


def test_a_run_leaves_weights_a_log_a_curve_and_a_list(
    finished: tuple[Training, TrainingRequest],
) -> None:
    training, request = finished

    outcome = train(training, request)  # there is nothing left to do

    out = request.out
    assert outcome == Outcome(out / "weights.safetensors", None, 0)
    assert load_network(out / "weights.safetensors").settings == training.network
    origin = read_origin(out / "weights.safetensors")
    assert origin["config"]["network"]["topology"]["k2"] == 4
    assert (origin["images"], origin["epochs"], origin["finished"]) == (5, 2, True)
    rows = rows_of(out)
    assert [(row["round"], row["epoch"]) for row in rows] == [("1", "1"), ("1", "2")]
    assert float(rows[1]["loss"]) < float(rows[0]["loss"])
    assert (out / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert (out / "images.csv").read_text().count("used") == 5
    assert not list(out.rglob("*.part"))


@pytest.mark.parametrize(("fall", "epochs"), [("10.0", 2), ("0.0", 4)])
def test_training_stops_on_a_plateau(fall: str, epochs: int, trained: Trained) -> None:
    slow = "descent.learning_rate=0.02"  # so slow that the error falls at each of four epochs
    rules = ("stopping.rule=plateau", "stopping.epochs=4", f"stopping.min_delta={fall}")
    assert len(rows_of(folder_of(trained("patches", *rules, slow)))) == epochs


def test_a_loss_of_nan_is_refused(trained: Trained, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Loop, "step", lambda *_: math.nan)
    with pytest.raises(
        DivergedError, match=r"descent.learning_rate: the loss is no longer"
    ) as error:
        trained("patches")
    assert error.value.exit_code == ExitCode.SOME_FAILED


def test_the_weights_that_are_written_are_the_mean_over_the_steps(trained: Trained) -> None:
    changes = ("stopping.epochs=1", "descent.batch=5", "descent.ema=0.9")
    still = folder_of(trained("images", *changes, "descent.learning_rate=1e-9", out="still"))
    out = folder_of(trained("images", *changes, "descent.learning_rate=0.5", out="moved"))

    assert not (out / "adaptation.html").exists()  # it compares with the weights before
    # One step: the mean keeps one eleventh of the weights before it.
    states = [torch.load(run / "checkpoint.pt", weights_only=True) for run in (still, out)]
    begun, last = (state["network"] for state in states)
    assert not torch.equal(last["head.scores.bias"], begun["head.scores.bias"])
    written = load_network(out / "weights.safetensors").state_dict()
    for name in dict(make_network(training_of("images")).named_parameters()):
        mean, average = (begun[name] + 10 * last[name]) / 11, states[1]["average"][name]
        torch.testing.assert_close(average, mean)
        if name.startswith("head"):  # in the backbone normalisation is folded in
            assert torch.equal(written[name], average.half().to(average))


def test_what_killed_runs_left_half_written_is_removed(trained: Trained, tmp_path: Path) -> None:
    out, prepared = tmp_path / "run", tmp_path / "kept"
    for folder in (out, out / "labels-1", prepared, prepared / "below"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".roadtorch.0123abcd.part").touch()
    (out / RESULTS_FILE).write_text('{"labels-{}": ""}')

    trained("images", "stopping.epochs=1", prepared=prepared, out=out)

    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize(
    ("kind", "size"), [("patches", None), ("images", (32, 64)), ("images", (64, 96))]
)
def test_a_run_can_start_from_the_weights_of_another_whatever_size_it_learned_at(
    kind: str, size: tuple[int, int] | None, trained: Trained, tmp_path: Path
) -> None:
    network = make_network(training_of(kind, "random_seed=5"))
    if size is not None:
        sides = {"height": size[0], "width": size[1]}
        network = BackboneNetwork(SMALL_BACKBONE.model_copy(update=sides))
    save_network(tmp_path / "first", network, {})
    start = f"initial_weights={json.dumps(str(tmp_path / 'first'))}"

    run = folder_of(trained(kind, start, "descent.learning_rate=1e-9", "stopping.epochs=1"))

    # With next to no rate the weights stay where they started.
    after = load_network(run / "weights.safetensors")
    for name, weight in load_network(tmp_path / "first").state_dict().items():
        torch.testing.assert_close(after.state_dict()[name], weight, atol=1e-6, rtol=0)
    if isinstance(after, BackboneNetwork):
        assert (after.settings.height, after.settings.width) == (32, 64)
    assert (run / "labels-1").exists() == (kind == "images")


# --- cut short -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", WHOLE)
def test_a_run_in_pieces_ends_with_the_bits_of_a_whole_one(
    kind: str, whole: dict[str, Path], trained: Trained, monkeypatch: pytest.MonkeyPatch
) -> None:
    cuts = 0
    for cut in (1, 1, 1, 1):
        with monkeypatch.context() as patch:
            interrupt_after(cut, patch)
            outcome = trained(kind, WHOLE[kind], out=f"pieces-{kind}")
        cuts += outcome.interrupted == signal.SIGTERM
    pieces = folder_of(trained(kind, WHOLE[kind], out=f"pieces-{kind}"))

    assert cuts >= 3
    name = "weights.safetensors"
    assert (pieces / name).read_bytes() == (whole[kind] / name).read_bytes()
    assert rows_of(pieces) == rows_of(whole[kind])


def test_a_run_that_was_killed_at_the_end_of_an_epoch_goes_on(
    whole: dict[str, Path], trained: Trained, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(training_loop, "SAVE_INTERVAL", 0.0)
        patch.setattr(Loop, "_end_epoch", lambda _: pytest.fail("killed"))
        with pytest.raises(pytest.fail.Exception, match="killed"):
            trained("images", WHOLE["images"], out="killed")

    killed = folder_of(trained("images", WHOLE["images"], out="killed"))

    name = "weights.safetensors"
    assert (killed / name).read_bytes() == (whole["images"] / name).read_bytes()
    assert rows_of(killed) == rows_of(whole["images"])


def test_the_status_of_the_command_names_the_signal(
    call: Call, streets: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, out = write_config(tmp_path / "c.toml", PATCHES), tmp_path / "run"
    interrupt_after(1, monkeypatch)
    words = ["--config", config, "--images", streets, "--out", out]

    result = call("train", *words)

    assert result.exit_code == 143
    assert result.stderr.endswith("stopped by SIGTERM; run the same command again to resume\n")
    assert read_origin(out / "weights.safetensors")["finished"] is False
