"""roadtorch tune: thresholds chosen on labelled pictures, into configs that infer reads."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean

import cv2
import pytest
from pydantic import Field
from torch import nn

from roadtorch.cli.options import DetectorOptions
from roadtorch.data.catalogue import open_dataset
from roadtorch.detectors.catalogue import list_detectors, load_detector, register
from roadtorch.detectors.detector import DetectorSettings, Entry
from roadtorch.evaluation import uncertainty
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.metrics import decisions_at, f_measure
from roadtorch.evaluation.result import held_out_thresholds
from roadtorch.evaluation.tuning import choose_threshold
from tests.oracle import GROUPS, write_set


class BrightnessSettings(DetectorSettings):
    """Settings of a detector that takes the mean of the channels for road."""

    gain: float = Field(default=1.0, ge=0, le=1)


class Brightness(nn.Module):
    def __init__(self, settings: BrightnessSettings) -> None:
        super().__init__()
        self.gain = settings.gain

    def forward(self, image):
        return {"likelihood": image.mean(0) * self.gain}


@pytest.fixture(scope="module", autouse=True)
def known_detector() -> None:
    if "test-brightness" not in list_detectors():
        register(Entry("test-brightness", "bright is road", BrightnessSettings, Brightness))


@pytest.fixture(scope="module", autouse=True)
def _few_draws() -> Iterator[None]:
    """Intervals of a tenth of the draws."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uncertainty, "REPLICATES", 100)
        yield


@pytest.fixture
def camvid(tmp_path) -> Path:
    return write_set(tmp_path / "camvid")


def test_the_config_holds_the_choice_its_command_and_its_worth(call, camvid, tmp_path):
    out = tmp_path / "configs"
    options = ("--detector", "test-brightness", "--set", "gain=0.5")

    done = call("tune", "camvid", camvid, *options, "--out", out)

    assert done.exit_code == 0, done.stderr
    text = (out / "test-brightness.toml").read_text()
    assert f"#   roadtorch tune camvid {camvid}" in text
    assert "camvid dev, 6 pictures" in text
    assert "Each group at the threshold of the others: F 0." in text
    detector, values = DetectorOptions(config=out / "test-brightness.toml").named()
    assert (detector, values["gain"]) == ("test-brightness", 0.5)
    assert load_detector(detector, **values).settings.model_dump(mode="json") == values
    header, row = done.stdout.splitlines()
    assert header.split()[:5] == ["detector", "default", "F", "at", "default"]
    name, default, f_default, threshold, f, *_ = row.split()
    assert (name, default, threshold) == ("test-brightness", "0.500", f"{values['threshold']:.3f}")
    assert f"At the default threshold 0.500: F {f_default}." in text
    assert float(f_default) < float(f)


def test_every_detector_gets_its_own_file_and_baselines_none(call, camvid, tmp_path):
    out, options = tmp_path / "configs", ("--limit", 2, "--detector", "prior:uniform")

    call("tune", "camvid", camvid, "--detector", "cpf:squares", *options, "--out", out)

    assert {path.name for path in out.iterdir()} == {"cpf-squares.toml"}
    assert tomllib.loads((out / "cpf-squares.toml").read_text())["detector"] == "cpf:squares"


def test_the_choice_is_the_best_threshold_averaged_over_groups(camvid):
    run = evaluate(open_dataset("camvid", camvid), ["test-brightness"], settings={"gain": 0.5})
    roads = run.tallies["test-brightness"].road

    def mean_f(thresholds: dict[str, float]) -> float:
        outcomes = [decisions_at(roads[group], at) for group, at in thresholds.items()]
        return fmean(float(f_measure(outcome)) for outcome in outcomes)

    found = choose_threshold(run, "test-brightness", {"gain": 0.5})

    best = max(mean_f(dict.fromkeys(roads, step / 500)) for step in range(251))
    assert found.settings == BrightnessSettings(threshold=found.settings.threshold, gain=0.5)
    assert found.chosen["f"] == pytest.approx(
        mean_f(dict.fromkeys(roads, found.settings.threshold))
    )
    assert found.chosen["f"] > best - 0.002
    assert found.at_default["f"] == pytest.approx(mean_f(dict.fromkeys(roads, 0.5)))
    assert found.held_out["f"] == pytest.approx(mean_f(held_out_thresholds(roads)))


def test_a_drive_that_is_left_out_chooses_nothing(call, camvid, tmp_path):
    options = ("--detector", "test-brightness", "--leave-out", GROUPS[0])

    def chosen(*more) -> str:
        done = call("tune", "camvid", camvid, *options, *more, "--out", tmp_path / "out")
        assert done.exit_code == 0, done.stderr
        return done.stdout.splitlines()[1]

    before = chosen()
    for path in camvid.glob(f"*annot/{GROUPS[0]}*"):  # its labels may say what they like
        labels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert labels is not None
        cv2.imwrite(str(path), labels[::-1])

    assert chosen() == before
    assert "4 pictures" in (tmp_path / "out" / "test-brightness.toml").read_text()
