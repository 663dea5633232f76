"""Training with corrections of people: what they said is the target, and the weights say so."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from roadtorch.annotate.work import import_event
from roadtorch.cli.train import train as command_of_train
from roadtorch.data.corrections import Correction
from roadtorch.data.event_log import EventLog, LogHead, log_path
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError, InputError
from roadtorch.layout.weights import corrected_pictures, load_network, people_behind
from roadtorch.settings import read_settings_file
from roadtorch.train.config import Descent, Training
from roadtorch.train.corrections import corrections_summary, paced, write_corrected
from roadtorch.train.loop import RoundStart
from roadtorch.train.patches import (
    LabelledCentres,
    corrected_centres,
    correction_layout,
    repeated,
)
from roadtorch.train.pictures import corrected_shares, corrected_targets, correction_planes
from roadtorch.train.run import FUSION, Request, recipe_of, train
from roadtorch.train.teachers import Targets
from tests.train.conftest import Trained
from tests.train.runs import PATCHES, training_of, write_config

UNTOUCHED, ROAD, NOT_ROAD, VOID, SKY = range(5)


def correction(labels: np.ndarray, picture: Path = Path("street.png")) -> Correction:
    return Correction(picture, picture.name, labels.astype(np.uint8), False, ("ann",), 1.0, 1)


def quarters(height: int = 8, width: int = 8) -> np.ndarray:
    """Above sky and untouched, below road and not road."""
    labels = np.full((height, width), UNTOUCHED)
    labels[: height // 2, : width // 2] = SKY
    labels[height // 2 :, : width // 2] = ROAD
    labels[height // 2 :, width // 2 :] = NOT_ROAD
    return labels


def machine(size: int = 4) -> Targets:
    """Vertical, half road, all ego, each with weight 0.25."""
    layout = torch.zeros(1, 3, size, size)
    layout[:, 1] = 1
    quarter, half, one = (torch.full((1, 1, size, size), value) for value in (0.25, 0.5, 1.0))
    return Targets(layout, quarter, half, quarter, one, quarter)


def planes(labels: np.ndarray, size: int = 4) -> torch.Tensor:
    return correction_planes(correction(labels), (size, size))["planes"][None] / 255


def test_what_was_said_replaces_the_machines_target_and_has_its_weight() -> None:
    found = corrected_targets(machine(), planes(quarters()), 3.0)

    assert found.road[0, 0, 2:].tolist() == [[1, 1, 0, 0]] * 2
    assert found.road_weight[0, 0, 2:].eq(3).all()
    assert found.road[0, 0, :2, :2].eq(0).all()  # sky is no road
    assert found.road[0, 0, :2, 2:].eq(0.5).all()
    assert found.road_weight[0, 0, :2, 2:].eq(0.25).all()
    assert found.layout[0, 0, :2, :2].eq(1).all()
    assert found.layout[0, 2, 2:, :2].eq(1).all()  # road is horizontal
    assert found.layout[0, 1, 2:, 2:].eq(1).all()  # "not road" says nothing of the layout
    assert found.ego[0, 0, 2:, :2].eq(0).all()
    assert found.ego[0, 0, 2:, 2:].eq(1).all()


def test_void_counts_for_nothing() -> None:
    labels = quarters()
    labels[4:, :4] = VOID

    found = corrected_targets(machine(), planes(labels), 1.0)

    assert found.road_weight[0, 0, 2:, :2].eq(0).all()
    assert found.layout_weight[0, 0, 2:, :2].eq(0).all()


def test_nothing_said_changes_nothing() -> None:
    before = machine()
    for one, other in zip(
        corrected_targets(before, planes(quarters() * 0), 5.0), before, strict=True
    ):
        assert torch.equal(one, other)


def test_corrected_pictures_get_their_share_of_the_visits() -> None:
    shares = torch.tensor([1.0, 3.0, 2.0, 2.0])
    corrected = torch.tensor([True, False, False, True])

    found = corrected_shares(shares, corrected, 0.7)

    assert float(found[corrected].sum() / found.sum()) == pytest.approx(0.7)
    assert float(found[3] / found[0]) == pytest.approx(2)
    assert torch.equal(corrected_shares(shares, corrected | True, 0.7), shares)
    assert torch.equal(corrected_shares(shares, corrected & False, 0.7), shares)


def test_files_are_repeated_until_corrected_ones_are_their_share() -> None:
    files = [Path(name) for name in "abcdefgh"]
    said = {files[2]: Path("said")}

    assert repeated(files, said, 0.5).count(files[2]) == 7
    assert len(repeated(files, said, 0.5)) == 14
    assert repeated(files, said, 1.0) == [files[2]]
    assert repeated(files, {}, 0.5) == repeated(files, {}, 1.0) == files


def test_patches_are_taken_where_people_named_a_class() -> None:
    said = correction_layout(correction(quarters(48, 64)), (48, 64))
    sites = LabelledCentres(
        torch.tensor([[2, 2], [2, 60], [40, 2], [40, 60]], dtype=torch.int16),
        torch.tensor([1, 1, 1, 1], dtype=torch.uint8),
        torch.ones(4),
    )

    found = corrected_centres(sites, said, 2.5)

    assert found.centres[:2].tolist() == [[2, 60], [40, 60]]  # the others were spoken of
    assert set(found.classes[2:].tolist()) == {0, 2}
    assert len(found.classes) == 2 + 24
    assert found.weights.tolist() == [1, 1, *[2.5] * 24]


def corrected_street(streets: Path) -> Correction:
    return correction(quarters(60, 80), streets / "street_0.png")


def test_few_corrected_pictures_shorten_the_steps() -> None:
    descent = Descent(learning_rate=0.3, batch=7)
    assert paced(descent, 10, 0) == descent
    assert paced(descent, 0, 5) == descent
    assert paced(descent, 10, 5).learning_rate == pytest.approx(0.1)
    assert paced(descent, 10, 5).batch == 7
    assert paced(descent, 10, 1000).learning_rate < descent.learning_rate


def test_a_run_paces_its_steps_by_the_corrected_pictures(trained: Trained, streets: Path) -> None:
    """One corrected picture and a far halfway: next to no step is taken."""
    runs = {}
    for halfway in (1e6, 0.0):
        change, said = f"corrections.halfway={halfway}", [corrected_street(streets)]
        outcome = trained("pictures", change, out=f"run-{halfway}", corrections=said)
        runs[halfway] = load_network(outcome.weights or "").state_dict()
    begun = RoundStart(1, [], {}, None)
    start = recipe_of(training_of("pictures")).network(begun).state_dict()
    for name, weight in start.items():
        torch.testing.assert_close(runs[1e6][name], weight, atol=1e-6, rtol=0)
    assert any(not torch.allclose(runs[0.0][name], weight) for name, weight in start.items())


@pytest.mark.parametrize("kind", ["patches", "pictures"])
def test_weights_say_that_people_corrected_pictures(
    kind: str, trained: Trained, streets: Path, tmp_path: Path
) -> None:
    outcome = trained(kind, corrections=[corrected_street(streets)])

    assert outcome.weights is not None
    (told,) = people_behind(outcome.weights)
    assert (told["pictures"], told["people"], told["pixels"]) == (1, 1, 3 * 60 * 80 // 4)
    assert "not label-free" in outcome.weights.with_suffix(".md").read_text()
    assert corrected_pictures({"weights": {"file": str(outcome.weights)}}) == 1
    assert json.loads((tmp_path / "run" / "run.json").read_text())["corrections"] == told
    assert (tmp_path / "run" / FUSION).exists() == (kind == "pictures")
    if kind == "pictures":
        values = read_settings_file(tmp_path / "run" / FUSION)
        assert values["detector"] == "fusion"
        assert values["weights"]["file"] == str(outcome.weights)


def test_the_command_reads_what_annotate_kept(streets: Path, kept: Path, tmp_path: Path) -> None:
    name, logs = "street_1.png", tmp_path / "corrections"
    head = LogHead(picture=f"elsewhere/{name}", user="ann", height=60, width=80)
    EventLog(log_path(logs, name, "ann"), head).add(import_event(quarters(60, 80).astype(np.uint8)))
    config = write_config(tmp_path / "train.toml", PATCHES)
    words = ["--config", config, "--images", streets, "--out", tmp_path / "run", "--quiet"]
    words += ["--corrections", logs, "--pictures", streets]

    result = CliRunner().invoke(command_of_train, [str(word) for word in words])

    assert result.exit_code == 0, result.output
    (told,) = people_behind(tmp_path / "run" / "weights.safetensors")
    assert told["pictures"] == 1


def test_what_goes_on_from_corrected_weights_is_not_label_free_either(
    trained: Trained, streets: Path
) -> None:
    first = trained("patches", out="first", corrections=[corrected_street(streets)]).weights
    second = trained("patches", f"start={first}", out="second").weights

    assert first
    assert second
    assert people_behind(second) == people_behind(first) != []


def test_resuming_wants_the_same_corrections(
    finished: tuple[Training, Request], streets: Path
) -> None:
    training, request = finished
    with pytest.raises(ConfigError, match="other corrections"):
        train(training, replace(request, corrections=[corrected_street(streets)]))


def test_corrections_of_other_pictures_are_refused(
    trained: Trained, streets: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="none of them is among --images"):
        trained("patches", corrections=[correction(quarters(), tmp_path / "x.png")])
    with pytest.raises(InputError, match="another size"):
        trained("patches", corrections=[correction(quarters(), streets / "street_0.png")])


def test_nothing_is_told_without_corrections_and_all_that_was_said_counts() -> None:
    assert corrections_summary({}) is None
    one, other = (
        corrections_summary({"a.png": correction(quarters() * factor)}) for factor in (1, 0)
    )
    assert one is not None
    assert other is not None
    assert one["sha256"] != other["sha256"]


def test_after_corrections_zero_are_the_log_odds_that_part_road(tmp_path: Path) -> None:
    file = tmp_path / "fusion.toml"

    assert write_corrected(file, tmp_path / "weights.safetensors", [correction(quarters())])

    values = read_settings_file(file)
    assert values["calibration"] == {"centre": 0.0}
    load_detector("fusion", calibration=values["calibration"])


def test_who_says_nothing_of_road_leaves_the_detector_as_it_is(tmp_path: Path) -> None:
    void = correction(np.full((8, 8), VOID))
    for one in (void, correction(np.zeros((8, 8)))):
        assert not write_corrected(tmp_path / "fusion.toml", tmp_path / "w", [one])
    assert not (tmp_path / "fusion.toml").exists()
