"""roadtorch evaluate, from files on disk to the table, metrics.json, rows and sheets."""

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
import torch
from click.testing import CliRunner, Result
from pydantic import Field
from torch import nn

from roadtorch.cli.evaluate import evaluate
from roadtorch.detector import DetectorSettings, Entry
from roadtorch.detectors.catalogue import list_detectors, register
from roadtorch.errors import ConfigError, DatasetError, InputError
from roadtorch.evaluation import runner
from roadtorch.evaluation.plan import expand_names, open_named
from roadtorch.evaluation.progress import FILE
from roadtorch.image import read_image
from roadtorch.scenes import render_scene, write_camvid, write_picture

DRIVES = ("0001TP", "0006R0", "0016E5")
SCENES = {f"{DRIVES[i % 3]}_{i}": render_scene(i, 48, 64) for i in range(6)}
TRUTH = {float(scene.image.double().sum()): scene for scene in SCENES.values()}


class OracleSettings(DetectorSettings):
    """Settings of a detector that knows the answers."""

    doubt: float = Field(default=0.0, ge=0, le=1)


class Oracle(nn.Module):
    """Looks the truth up by the sum of the image's pixels."""

    def __init__(self, settings: OracleSettings) -> None:
        super().__init__()
        self.doubt = settings.doubt

    def forward(self, image):
        scene = TRUTH[float(image.double().sum())]
        likelihood = scene.road.float() * (1 - self.doubt) + self.doubt / 2
        layout = torch.stack([scene.layout == kind for kind in range(3)]).float()
        return {"likelihood": likelihood, "layout": layout, "uniformity": likelihood}


@pytest.fixture(scope="module", autouse=True)
def known_oracle() -> None:
    if "test-oracle" not in list_detectors():
        register(Entry("test-oracle", "knows the truth", OracleSettings, Oracle))


@pytest.fixture
def camvid(tmp_path) -> Path:
    root = tmp_path / "camvid"
    write_camvid(root, "train", dict(list(SCENES.items())[:3]))
    write_camvid(root, "val", dict(list(SCENES.items())[3:]))
    return root


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(evaluate, [str(a) for a in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def metrics(out: Path) -> dict:
    return json.loads((out / "metrics.json").read_text())


def test_table_and_metrics_with_the_floors_beside(camvid, tmp_path):
    out = tmp_path / "out"

    result = run("camvid", camvid, "--detector", "test-oracle", "--out", out)

    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0].split()[:5] == ["detector", "MaxF", "0001TP", "MaxF", "0006R0"]
    assert lines[1].split()[:5] == ["test-oracle", "1.000", "1.000", "1.000", "1.000"]
    assert {line.split()[0] for line in lines[2:5]} == {
        "prior:rows",
        "prior:triangle",
        "prior:mean",
    }
    found = metrics(out)
    assert (found["dataset"], found["split"], found["images"]) == ("camvid", "dev", 6)
    assert found["void"] == "ignored"
    assert found["command"].startswith("roadtorch evaluate camvid ")
    best = found["detectors"]["test-oracle"]
    assert set(best["groups"]) == set(DRIVES)
    for key in ("auc_pooled", "auc_mean", "maxf", "ap", "iou"):
        assert best[key] == pytest.approx(1)
        assert best["groups"]["0001TP"][key] == pytest.approx(1)
    assert best["ms_per_image"] > 0
    assert best["ci95"]["maxf"] == pytest.approx([1, 1])
    assert best["layout"]["mean"] == 1
    assert best["layout"]["void_as_vertical"]["vertical"] <= 1
    assert best["settings"] == {"doubt": 0.0}


def test_rows_for_every_image_and_detector(camvid, tmp_path):
    out = tmp_path / "out"
    run("camvid", camvid, "--detector", "test-oracle", "--out", out)

    with (out / "images.csv").open() as file:
        rows = list(csv.DictReader(file))

    assert len(rows) == 6 * 4
    own = [row for row in rows if row["detector"] == "test-oracle"]
    assert {row["image"] for row in own} == set(SCENES)
    assert all(float(row["f"]) == 1 and row["status"] == "ok" for row in own)


def test_a_broken_picture_is_listed_and_the_rest_is_scored(camvid, tmp_path):
    out = tmp_path / "out"
    (camvid / "train" / "0001TP_0.png").write_bytes(b"")

    result = run("camvid", camvid, "--detector", "test-oracle", "--out", out)

    assert result.exit_code == 1
    assert "failed: 0001TP_0:" in result.stderr
    found = metrics(out)
    assert found["images"] == 5
    assert [failure["image"] for failure in found["failed"]] == ["0001TP_0"]
    assert found["detectors"]["test-oracle"]["maxf"] == pytest.approx(1)


def test_when_every_picture_is_broken_there_is_one_error(camvid):
    for path in camvid.glob("*/*.png"):
        if "annot" not in path.parent.name:
            path.write_bytes(b"x")

    with pytest.raises(DatasetError, match="none of its 6 pictures"):
        run("camvid", camvid, "--detector", "prior:rows")


def test_settings_reach_the_detector_and_not_the_floors(camvid, tmp_path):
    out = tmp_path / "out"
    arguments = ("camvid", camvid, "--detector", "test-oracle", "--set", "doubt=0.4", "--out", out)
    run(*arguments)

    found = metrics(out)["detectors"]["test-oracle"]

    assert found["settings"] == {"doubt": 0.4}
    assert found["maxf_threshold"] == pytest.approx(0.2, abs=1e-4)


def test_a_setting_the_detector_lacks_is_refused_before_the_run(camvid):
    with pytest.raises(ConfigError, match=r"duobt.*doubt"):
        run("camvid", camvid, "--detector", "test-oracle", "--set", "duobt=1")


def test_sets_without_drives_use_the_default_or_an_earlier_threshold(camvid, tmp_path):
    plain = folder_copy(camvid, tmp_path / "folder")
    first, own, given = (tmp_path / name for name in ("first", "own", "given"))
    detector = ("--detector", "test-oracle", "--set", "doubt=0.2")
    teach = ("--mean-from", f"camvid:{camvid}")

    run("camvid", camvid, *detector, "--out", first)
    run("folder", plain, *detector, "--out", own)
    earlier = ("--threshold-from", first / "metrics.json")
    run("folder", plain, *detector, *teach, *earlier, "--out", given)

    default, chosen = (metrics(out)["detectors"] for out in (own, given))
    assert "groups" not in default["test-oracle"]
    assert default["test-oracle"]["threshold"] == 0.5
    assert "prior:mean" not in default
    assert chosen["test-oracle"]["threshold_from"] == "an earlier run"
    before = metrics(first)["detectors"]
    for name in ("test-oracle", "prior:mean", "prior:rows"):
        assert chosen[name]["threshold"] == before[name]["maxf_threshold"]


def folder_copy(camvid: Path, root: Path) -> Path:
    """The same scenes as a folder of images and masks, without drives."""
    (root / "masks").mkdir(parents=True)
    for name, scene in SCENES.items():
        write_picture(root / "images" / f"{name}.png", scene)
        mask = torch.where(scene.void, 127, 255 * scene.road).to(torch.uint8)
        cv2.imwrite(str(root / "masks" / f"{name}.png"), mask.numpy())
    return root


def test_a_threshold_of_other_settings_is_refused(camvid, tmp_path):
    out = tmp_path / "out"
    run("camvid", camvid, "--detector", "test-oracle", "--out", out)
    again = ("camvid", camvid, "--detector", "test-oracle", "--set", "doubt=0.3")

    with pytest.raises(ConfigError, match="other settings"):
        run(*again, "--threshold-from", out / "metrics.json")
    with pytest.raises(ConfigError, match="no threshold for prior:uniform"):
        run(
            "camvid",
            camvid,
            "--detector",
            "prior:uniform",
            "--threshold-from",
            out / "metrics.json",
        )


def test_a_file_that_is_no_metrics_json(camvid, tmp_path):
    (tmp_path / "other.json").write_text("[1]")

    with pytest.raises(InputError, match=r"other\.json: is not a metrics\.json"):
        run(
            "camvid",
            camvid,
            "--detector",
            "prior:rows",
            "--threshold-from",
            tmp_path / "other.json",
        )


def test_mean_from_is_for_sets_that_cannot_teach_themselves(camvid):
    with pytest.raises(ConfigError, match="drives teach each other"):
        run("camvid", camvid, "--detector", "prior:rows", "--mean-from", f"camvid:{camvid}")


def test_limit_takes_pictures_evenly(camvid, tmp_path):
    out = tmp_path / "out"

    run("camvid", camvid, "--detector", "test-oracle", "--limit", 3, "--out", out)

    assert metrics(out)["images"] == 3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_goes_on_and_ends_like_a_whole_one(
    camvid, tmp_path, monkeypatch, number
):
    whole, out = tmp_path / "whole", tmp_path / "out"
    arguments = ("camvid", camvid, "--detector", "test-oracle", "--detector", "prior:uniform")
    run(*arguments, "--out", whole)
    looked: list[str] = []
    score_item = runner.score_item

    def interrupted(plan, found, item):
        looked.append(item.name)
        if len(looked) == 4:
            os.kill(os.getpid(), number)
        return score_item(plan, found, item)

    monkeypatch.setattr(runner, "score_item", interrupted)
    assert run(*arguments, "--out", out).exit_code != 0
    assert (out / FILE).is_file()
    assert not (out / "metrics.json").exists()
    looked[:] = ["none"] * 4
    result = run(*arguments, "--out", out)

    assert "going on after 4 of 6 pictures" in result.stderr
    assert len(looked) == 4 + 2
    assert not (out / FILE).exists()
    one, other = (without_times(metrics(folder)["detectors"]) for folder in (whole, out))
    assert one == other
    assert rows_without_times(whole) == rows_without_times(out)


def without_times(figures):
    if isinstance(figures, dict):
        return {key: without_times(part) for key, part in figures.items() if key != "ms_per_image"}
    return figures


def rows_without_times(out: Path) -> list[dict]:
    with (out / "images.csv").open() as file:
        return [{**row, "ms": ""} for row in csv.DictReader(file)]


def test_the_beginning_of_another_run_is_refused(camvid, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / FILE).write_bytes(b"something else")

    with pytest.raises(ConfigError, match="is not the progress of a run"):
        run("camvid", camvid, "--detector", "prior:rows", "--out", out)
    assert (out / FILE).read_bytes() == b"something else"


def test_anybodys_maps_are_scored_like_a_detector(camvid, tmp_path):
    theirs, out = tmp_path / "theirs", tmp_path / "out"
    theirs.mkdir()
    for name, scene in SCENES.items():
        cv2.imwrite(str(theirs / f"{name}.png"), (scene.road * 255).to(torch.uint8).numpy())

    result = run("camvid", camvid, "--maps", f"net={theirs}", "--out", out)

    assert result.exit_code == 0
    found = metrics(out)
    assert set(found["detectors"]) == {"maps:net", "prior:rows", "prior:triangle", "prior:mean"}
    assert found["detectors"]["maps:net"]["maxf"] == pytest.approx(1)
    assert found["detectors"]["maps:net"]["iou_mask"] == 1


def test_a_map_that_is_missing_fails_its_picture_alone(camvid, tmp_path):
    theirs, out = tmp_path / "theirs", tmp_path / "out"
    theirs.mkdir()
    for name in list(SCENES)[1:]:
        cv2.imwrite(str(theirs / f"{name}.png"), SCENES[name].road.to(torch.uint8).numpy())

    result = run("camvid", camvid, "--maps", theirs, "--out", out)

    assert result.exit_code == 1
    missing = next(iter(SCENES))
    assert f"failed: {missing}: maps:theirs: {theirs / missing}.png: is missing" in result.stderr
    assert metrics(out)["images"] == 5


def test_two_folders_of_maps_need_two_names(camvid, tmp_path):
    (tmp_path / "a" / "maps").mkdir(parents=True)
    (tmp_path / "b" / "maps").mkdir(parents=True)

    with pytest.raises(ConfigError, match="two folders one name"):
        run("camvid", camvid, "--maps", tmp_path / "a/maps", "--maps", tmp_path / "b/maps")


def test_detectors_are_compared_on_the_same_pictures(camvid, tmp_path):
    out = tmp_path / "out"

    result = run("camvid", camvid, "--detector", "test-oracle", "--out", out)
    run("camvid", camvid, "--detector", "test-oracle", "--against", "prior:rows", "--out", out)

    assert "less test-oracle" in result.stdout
    found = metrics(out)["paired"]
    assert found["against"] == "prior:rows"
    gain = found["detectors"]["test-oracle"]["maxf"]
    assert 0 < gain["ci95"][0] <= gain["difference"] <= gain["ci95"][1]
    with pytest.raises(ConfigError, match="detector of this run"):
        run("camvid", camvid, "--detector", "prior:rows", "--against", "test-oracle")


def test_curves_and_a_report_are_left_behind(camvid, tmp_path):
    out = tmp_path / "out"
    run("camvid", camvid, "--detector", "test-oracle", "--out", out)

    curves = json.loads((out / "curves.json").read_text())
    report = (out / "report.html").read_text()

    assert curves["test-oracle"]["mean"]["roc"][1][1] == 1  # straight up
    assert set(curves["test-oracle"]["groups"]) == set(DRIVES)
    assert "test-oracle" in report
    assert report.count("<svg") >= 2
    assert "data:image/jpeg;base64," in report


def test_birds_eye_view_is_for_sets_with_calibrations(camvid):
    with pytest.raises(ConfigError, match="bird"):
        run("camvid", camvid, "--bev")


def test_sheets_of_best_median_and_worst(camvid, tmp_path):
    out = tmp_path / "out"
    run("camvid", camvid, "--detector", "test-oracle", "--montage", 2, "--out", out)

    sheets = {path.name: read_image(path) for path in out.glob("montage.*")}
    parts = ("best", "median", "worst")
    assert set(sheets) == {f"montage.test-oracle.{part}.jpg" for part in parts}
    # Five tiles of 320 pixels: image, layout, uniformity, likelihood, decision; two rows.
    assert all(sheet.shape == (3, 2 * (240 + 18), 5 * 320) for sheet in sheets.values())


def test_no_sheets_where_none_are_wanted(camvid, tmp_path):
    out = tmp_path / "out"

    run("camvid", camvid, "--detector", "test-oracle", "--montage", 0, "--out", out)

    assert not list(out.glob("montage.*"))


def test_an_output_folder_that_cannot_be_made(camvid, tmp_path):
    (tmp_path / "file").write_text("")

    with pytest.raises(InputError, match="file/out: cannot be made"):
        run("camvid", camvid, "--detector", "prior:rows", "--out", tmp_path / "file" / "out")


def test_a_folder_that_cannot_be_written_is_refused_before_the_run(camvid, tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    monkeypatch.setattr("roadtorch.evaluation.runner.run", None)  # must not be reached

    with pytest.raises(InputError, match="out: cannot be written: Permission denied"):
        run("camvid", camvid, "--detector", "prior:rows", "--out", tmp_path / "out")


def test_a_set_and_its_folder_in_one_word(camvid):
    assert open_named(f"camvid:{camvid}").root == camvid
    with pytest.raises(ConfigError, match="write NAME:ROOT"):
        open_named(str(camvid))


def test_wildcards_and_misspelt_names():
    assert expand_names(["prior:t*", "prior:rows", "prior:*"])[:2] == [
        "prior:triangle",
        "prior:rows",
    ]
    with pytest.raises(ConfigError, match="unknown detector"):
        expand_names(["nothing*"])
    with pytest.raises(ConfigError, match="test-oracle"):
        expand_names(["test-oracel"])


def test_one_class_detectors_get_p3s_table(camvid, tmp_path):
    out, names = tmp_path / "out", ("oneclass:gaussian:HS", "oneclass:hist64_s:S")
    chosen = [word for name in names for word in ("--detector", name)]

    result = run("camvid", camvid, *chosen, "--montage", 0, "--out", out)

    text = (out / "table3.txt").read_text()
    assert text in result.stdout
    ours = 100 * metrics(out)["detectors"]["oneclass:gaussian:HS"]["auc_mean"]
    assert f"*{ours:.1f}/93.2" in text
    assert len((out / "table3.csv").read_text().splitlines()) == 3
    assert {path.name for path in out.glob("fig*")} == {"fig8.svg", "fig9.svg"}
    assert "<b>" in (out / "table3.html").read_text()


def test_a_star_leaves_the_one_class_grid_out_and_its_family_brings_it_in():
    everything, grid, row = map(expand_names, (["*"], ["oneclass:*:*"], ["oneclass:nn:*", "cpf"]))

    assert {"cpf", "fusion", "prior:rows"} <= set(everything)
    assert not any(name.startswith("oneclass:") for name in everything)
    assert (len(grid), len(row)) == (310, 20)


def test_a_mistake_is_one_line_and_exit_code_2(tmp_path):
    command = [sys.executable, "-m", "roadtorch", "evaluate", "camvid", str(tmp_path)]
    done = subprocess.run([*command, "--detector", "prior:rows"], capture_output=True, text=True)

    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith(f"roadtorch: error: {tmp_path}/train: does not exist")
    assert done.stderr.count("\n") == 1


def test_help_does_not_import_torch():
    code = (
        "import sys; from roadtorch.cli.evaluate import evaluate; "
        "evaluate(['--help'], standalone_mode=False); sys.exit('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)

    assert done.returncode == 0, done.stderr
    assert "--threshold-from" in done.stdout
