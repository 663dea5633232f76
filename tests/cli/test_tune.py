"""roadtorch tune: thresholds chosen on labelled pictures, into configs that infer reads."""

import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import torch
from pydantic import Field
from torch import nn

from roadtorch.detector import DetectorSettings, Entry
from roadtorch.detectors.catalogue import list_detectors, load_detector, register
from roadtorch.evaluation.evaluate import choose_threshold
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.result import shared_threshold
from roadtorch.evaluation.tally import Tally
from roadtorch.runs.options import DetectorOptions
from roadtorch.scenes.street import render_scene
from tests.oracle import GROUPS, write_set
from tests.reports import changed, scored
from tests.streets import write_camvid


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
    assert not (out / "progress.pt").exists()


def test_every_detector_gets_its_own_file_and_baselines_none(call, camvid, tmp_path):
    out = tmp_path / "configs"

    call("tune", "camvid", camvid, "--detector", "cpf", "--detector", "cpf:squares", "--out", out)

    assert {path.name for path in out.iterdir()} == {"cpf.toml", "cpf-squares.toml"}
    assert tomllib.loads((out / "cpf-squares.toml").read_text())["detector"] == "cpf:squares"


def test_the_choice_is_the_best_threshold_averaged_over_groups():
    def at(road: int, other: int) -> torch.Tensor:
        levels = torch.zeros(2, 11, dtype=torch.int64)
        levels[0, road] = levels[1, other] = 10
        return levels

    sums = {"a": at(5, 4), "b": at(8, 4)}
    counts = {group: RoadCounts(*levels) for group, levels in sums.items()}
    run = changed(
        scored({"test-brightness": None}),
        "test-brightness",
        best_threshold=shared_threshold(counts),
        groups={"a": {}, "b": {}},
    )
    run = replace(run, tallies={"test-brightness": Tally({"road": sums})})

    found = choose_threshold(run, "test-brightness", {"gain": 0.5})

    assert found.settings == BrightnessSettings(threshold=0.5, gain=0.5)
    assert (found.f, found.iou) == (1, 1)
    # At the default of 0.5, too, both have all of their road and nothing else.
    assert found.f_default == 1
    # Drive a at the threshold of b (0.5 or more up to 0.8, the lowest: 0.5), b at that of a.
    assert found.f_held_out == 1


def test_pictures_without_road_choose_nothing(call, tmp_path):
    scene = render_scene(0, 48, 64)
    scene.classes[scene.classes == 3] = 4  # pavement everywhere
    write_camvid(tmp_path / "set", "train", {"0001TP_0": scene})

    done = call(
        *("tune", "camvid", tmp_path / "set", "--split", "train"),
        *("--detector", "test-brightness", "--out", tmp_path / "out"),
    )

    assert done.exit_code == 1
    assert "there is no road in any label (check" in done.stderr


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
