"""Self-training: a run from random weights in two rounds, its labels, its samples, its settings."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from roadtorch import load_detector
from roadtorch.base.errors import ConfigError
from roadtorch.base.signals import StopRequest
from roadtorch.detectors.detector import Detector
from roadtorch.inputs.images import find_images
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.weights import load_network, save_network
from roadtorch.run.memo import read_arrays
from roadtorch.train.config import SelfTraining, build_training
from roadtorch.train.run import TrainingRequest, make_network, make_recipe, prepare_folder, train
from roadtorch.train.self_training import (
    SelfTeacher,
    SelfTrainingRecipe,
    label_targets,
    round_weights,
    weigh_borders,
)
from roadtorch.train.training_loop import TrainingInputs
from tests.command import Call
from tests.networks import write_random_network
from tests.train.runs import (
    SELF_TRAINING,
    interrupt_after,
    rows_of,
    training_of,
    write_config,
    write_worlds,
)

WORLDS = [f"3000{number}_{kind}_sun" for number, kind in enumerate(("town", "town", "trail"))]


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write worlds that train, each with an ego car, and one that is held out."""
    folder = tmp_path_factory.mktemp("worlds")
    return write_worlds(folder, [*WORLDS, "39000_town_sun"], ego_rows=8)


@pytest.fixture(scope="module")
def request_of_run(
    streets: Path, worlds: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> TrainingRequest:
    out = tmp_path_factory.mktemp("self") / "run"
    return TrainingRequest(str(streets), out, cache / "self", quiet=True, source=[worlds])


@pytest.fixture(scope="module")
def run(request_of_run: TrainingRequest) -> Path:
    """Return the folder of a finished run."""
    outcome = train(training_of("self-training"), request_of_run)
    assert outcome.weights is not None
    return request_of_run.out


# --- a run ------------------------------------------------------------------------------


def test_a_run_leaves_weights_a_card_a_log_and_a_sheet_of_each_round(run: Path) -> None:
    files = {path.name for path in run.iterdir()}
    card, settings = (run / "weights.md").read_text(), training_of("self-training").network

    assert {"weights.safetensors", "curve.png", "sheet-1.jpg", "sheet-2.jpg"} <= files
    assert [(row["round"], row["epoch"]) for row in rows_of(run)] == [("1", "1"), ("2", "1")]
    assert "| source | 3 images with a renderer's truth (town 2, trail 1) |" in card
    assert "| target | 5 images" in card
    assert len(card.split()) <= 300
    assert load_network(run / "weights.safetensors").settings == settings
    load_detector("fusion", weights={"file": str(run / "weights.safetensors")})


def test_a_run_in_pieces_ends_with_the_bits_of_a_whole_one(
    run: Path, request_of_run: TrainingRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    training, request = training_of("self-training"), replace(request_of_run, out=tmp_path / "run")
    for _ in range(3):  # in the first round, between the two, in the second
        with monkeypatch.context() as patch:
            interrupt_after(1, patch)
            assert train(training, request).interrupted

    train(training, request)

    for name in ("round-1.safetensors", "weights.safetensors", "weights.md"):
        assert (request.out / name).read_bytes() == (run / name).read_bytes()
    assert rows_of(request.out) == rows_of(run)


def test_the_command_takes_source_images(
    call: Call, streets: Path, worlds: Path, cache: Path, tmp_path: Path
) -> None:
    config = write_config(tmp_path / "c.toml", SELF_TRAINING.replace("target = 0.5", ""))
    words = ["--config", config, "--images", streets, "--out", tmp_path / "run"]

    missing = call("train", *words)
    result = call("train", *words, "--source", worlds)

    assert "--source: is missing" in missing.stderr
    assert result.exit_code == 0
    card = (tmp_path / "run" / "weights.md").read_text()
    assert re.search(r"\| command \| `roadtorch train .*--source ", card)


def test_a_foreign_sheet_is_not_replaced(request_of_run: TrainingRequest, tmp_path: Path) -> None:
    (tmp_path / "sheet-2.jpg").touch()
    with pytest.raises(ConfigError, match=r"sheet-2.jpg: exists and was not written by roadtorch"):
        train(training_of("self-training"), replace(request_of_run, out=tmp_path))


# --- rounds -----------------------------------------------------------------------------


class Round:
    """A prepared recipe with the weights of a first round."""

    def __init__(self, request: TrainingRequest, out: Path, *changes: str) -> None:
        training = training_of("self-training", *changes)
        recipe = make_recipe(training, request.source)
        assert isinstance(recipe, SelfTrainingRecipe)
        assert request.prepared is not None
        self.recipe, self.out = recipe, out
        images = find_images([request.images])
        prepared = prepare_folder(recipe, images, request.prepared, StopRequest(), True)
        self.files = [item.file for item in prepared if item.file]
        network = make_network(training, number=2).eval()
        assert isinstance(network, BackboneNetwork)
        self.network = network

    def samples(self, number: int = 2) -> Any:
        inputs = TrainingInputs(self.files, {}, None, self.out, number)
        return self.recipe.make_samples(inputs, StopRequest(), True)

    def save(self) -> None:
        save_network(round_weights(self.out, 1), self.network, {})


def test_labels_are_those_of_the_weights_and_are_made_once(
    request_of_run: TrainingRequest, tmp_path: Path
) -> None:
    second = Round(request_of_run, tmp_path)
    second.save()
    labels = [*second.samples().labels.values()]
    before = [(path.stat().st_mtime_ns, read_arrays(path, "maps")["maps"]) for path in labels]

    second.samples()
    again = [path.stat().st_mtime_ns for path in labels]
    with torch.no_grad():
        bias = second.network.head.scores.bias
        assert bias is not None
        bias[3] += 9.0
    second.save()
    second.samples()

    assert len(labels) == 5
    assert again == [time for time, _ in before]
    for path, (_, maps) in zip(labels, before, strict=True):
        new = read_arrays(path, "maps")["maps"]
        assert new.shape == (5, 36, 38)
        assert new[3].float().mean() > maps[3].float().mean()


def test_the_road_of_labels_is_one_half_where_mask_and_likelihood_disagree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = torch.rand(3, 40, 40)
    detection = load_detector("fusion:large").detect(image)
    mask, ego = torch.zeros(2, 40, 40, dtype=torch.bool)
    mask[:, :30], ego[30:] = True, True
    likelihood = torch.full((40, 40), 0.9).where(torch.arange(40) < 20, 0.2)
    changed = replace(
        detection, likelihood=likelihood, mask=mask, cues={**detection.cues, "ego": ego}
    )
    monkeypatch.setattr(Detector, "detect", lambda *_: changed)

    labels = SelfTeacher(write_random_network(tmp_path / "mine.safetensors", 0)).label(image)

    assert labels[3, 0, [5, 25, 35]].tolist() == pytest.approx([0.9, 0.5, 0.2])
    assert not labels[3, ego].any()
    assert labels[4].bool().equal(~ego)


def test_half_of_a_batch_is_target_and_a_first_round_has_none(
    request_of_run: TrainingRequest, tmp_path: Path
) -> None:
    rounds = Round(request_of_run, tmp_path)
    rounds.save()

    first, second = rounds.samples(1), rounds.samples(2)

    weights = second.sampling_weights
    assert (len(first.labels), len(second.labels)) == (0, 5)
    assert float(weights[3:].sum() / weights.sum()) == pytest.approx(0.5)
    kinds = weights[:3] / weights[2]
    assert kinds.tolist() == pytest.approx([2**-0.5, 2**-0.5, 1])
    assert {kind: len(files) for kind, files in first.ego_cars.items()} == {"town": 2, "trail": 1}
    (batch,) = second.batches(0, 0)
    assert tuple(batch.targets.shape[-2:]) == tuple(side // 2 for side in batch.inputs.shape[-2:])
    assert 0 <= batch.inputs.min() <= batch.inputs.max() <= 1


def test_a_run_writes_the_exponential_mean_of_the_rounds_whose_backbone_learned(
    request_of_run: TrainingRequest, tmp_path: Path
) -> None:
    factors = ", ".join(f"{{backbone_factor = {factor}}}" for factor in (0.0, 0.4, 0.4, 0.4))
    rounds = Round(request_of_run, tmp_path, f"rounds=[{factors}]")
    rounds.samples(1)
    files = [write_random_network(tmp_path / f"{seed}.safetensors", seed) for seed in range(4)]
    networks = [load_network(file) for file in files]

    finish = rounds.recipe.finish_round
    written = [finish(network, tmp_path, number) for number, network in enumerate(networks, 1)]

    for count, members in ((1, [0]), (2, [1]), (3, [1, 2]), (4, [1, 2, 3, 3])):
        for name, weight in written[count - 1].state_dict().items():
            parts = [networks[member].state_dict()[name].double() for member in members]
            expected = torch.stack(parts).mean(0).to(weight)
            torch.testing.assert_close(weight, expected, atol=2e-3, rtol=2e-3)


@pytest.mark.parametrize(
    ("number", "frozen", "learning"), [(1, 0, set()), (2, 0, {"stem", "blocks"}), (2, 15, set())]
)
def test_a_frozen_backbone_and_frozen_blocks_do_not_learn(
    number: int, frozen: int, learning: set[str], request_of_run: TrainingRequest, tmp_path: Path
) -> None:
    rounds = Round(request_of_run, tmp_path, f"frozen_blocks={frozen}")
    groups = rounds.recipe.parameter_groups(rounds.network, number)

    names = {id(weight): name for name, weight in rounds.network.named_parameters()}
    parts = [{names[id(weight)] for weight in group["params"]} for group in groups]
    assert all(name.startswith("head.") for name in parts[0])
    found = {name.split(".")[1] for part in parts[1:] for name in part}
    assert found == learning
    assert [group["factor"] for group in groups] == [1.0, *([0.4] if learning else [])]


# --- targets ----------------------------------------------------------------------------


def test_labels_count_where_they_are_certain_and_say_nothing_of_the_ego_car() -> None:
    maps = torch.tensor([[0.5, 0.4, 0.1], [0.35, 0.5, 0.1], [0.15, 0.1, 0.8]])
    maps = torch.cat([maps, torch.tensor([[0.7, 0.52, 0.05], [1.0, 1.0, 0.0]])])
    training = training_of("self-training")
    assert isinstance(training, SelfTraining)

    targets = label_targets(maps[None, :, None], training)

    assert targets.layout_weight.flatten().tolist() == [0, 0, 0]  # 0.15, 0.1 ahead; ego car
    assert targets.road_weight.flatten().tolist() == [1, 0, 1]
    assert not targets.ego_weight.any()


def test_borders_of_road_and_vertical_weigh_where_truth_is_exact() -> None:
    planes = torch.zeros(2, 8, 6, 8)
    planes[:, 3] = planes[:, 5] = planes[:, 4] = planes[:, 2] = 1  # road everywhere
    same = weigh_borders(planes, torch.tensor([True, False]), 3.0)
    planes[:, 1, :, 4], planes[:, 2, :, 4], planes[:, 4, :, 4] = 1, 0, 0

    weighed = weigh_borders(planes, torch.tensor([True, False]), 3.0)

    assert torch.equal(same[:, 5], torch.ones(2, 6, 8))
    for plane in (3, 5):
        assert weighed[0, plane, 0].tolist() == [1, 1, 1, 4, 4, 4, 1, 1]
        assert weighed[1, plane, 0].tolist() == [1, 1, 1, 0, 0, 0, 1, 1]


# --- settings ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rounds": [{"target": 0.5}]}, "rounds.0.target: is not 0, but no network"),
        ({"sizes": [[100, 64]]}, "sizes.0.0: 100 was given .*multiple of 32"),
    ],
)
def test_contradictions_are_told_with_their_key(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build_training({"kind": "self-training", **values})


def test_source_images_are_for_this_kind_alone(worlds: Path) -> None:
    with pytest.raises(ConfigError, match="--source: is for trainings of the kind self-training"):
        make_recipe(training_of("images"), [worlds])
