"""roadtorch evaluate, from files on disk to the table, metrics.json, rows and sheets of images."""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from PIL import Image

from roadtorch.annotate.session import make_import_event
from roadtorch.base.errors import InputError
from roadtorch.base.image import read_image
from roadtorch.cli.evaluate import evaluate_command
from roadtorch.cli.options import DetectorOptions
from roadtorch.data.corrections import EventLog, LogHeader, log_path
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import scoring, uncertainty
from roadtorch.evaluation.report import files
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.weights import save_network
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import Call, invoke_command
from tests.networks import SMALL_BACKBONE
from tests.oracle import DECISION, GROUPS, ORACLE, SCENES, register_oracle, write_set


@pytest.fixture(scope="module", autouse=True)
def _few_draws() -> Iterator[None]:
    """Compute intervals from a tenth of the bootstrap replicates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uncertainty, "REPLICATES", 100)
        yield


@pytest.fixture(scope="module")
def camvid(tmp_path_factory) -> Path:
    register_oracle()
    return write_set(tmp_path_factory.mktemp("set") / "camvid")


run = partial(invoke_command, evaluate_command)


@pytest.fixture(scope="module")
def whole(camvid, tmp_path_factory) -> tuple[Result, Path]:
    """Run once; return the result and the output folder."""
    out = tmp_path_factory.mktemp("run") / "out"
    return run("camvid", camvid, "--detector", ORACLE, "--montage", 2, "--out", out), out


@pytest.fixture
def _no_page(monkeypatch):
    """Skip the charts: they take longer than all scores here."""
    monkeypatch.setattr(files, "build_charts", lambda _: {})


def metrics(out: Path) -> dict:
    return json.loads((out / "metrics.json").read_text())


# --- one run, and all that it leaves -------------------------------------------------------------


def test_a_table_metrics_and_a_report_are_left_behind(whole):
    result, out = whole

    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0].split()[:5] == ["detector", "MaxF", "0001TP", "MaxF", "0006R0"]
    assert lines[1].split()[:5] == [ORACLE, "1.000", "1.000", "1.000", "1.000"]
    baselines = {"prior:rows", "prior:triangle", "prior:mean"}
    assert {line.split()[0] for line in lines[2:5]} == baselines
    written = metrics(out)
    assert (written["dataset"], written["split"], written["images"]) == ("camvid", "dev", 6)
    assert (written["void"], written["command"].split()[:3]) == (
        "ignored", ["roadtorch", "evaluate", "camvid"]
    )  # fmt: skip
    best = written["detectors"][ORACLE]
    assert [best["maxf"], best["groups"]["0001TP"]["maxf"]] == pytest.approx([1, 1])
    assert best["ms_per_image"] > 0
    assert f"| {ORACLE} | 1.000 |" in (out / "tables.md").read_text()
    report = (out / "report.html").read_text()
    assert report.count("data:image/svg+xml;base64,") == 3
    assert report.count("data:image/jpeg;base64,") == 3


def test_sheets_of_best_median_and_worst(whole):
    sheets = {path.name: read_image(path) for path in whole[1].glob("montage.*")}

    assert set(sheets) == {f"montage.{ORACLE}.{part}.jpg" for part in ("best", "median", "worst")}
    # Five tiles of 320 pixels: image, layout, uniformity, likelihood, decision; two rows.
    assert all(sheet.shape == (3, 2 * (240 + 18), 5 * 320) for sheet in sheets.values())


@pytest.mark.usefixtures("_no_page")
def test_options_reach_the_run(camvid, tmp_path):
    table = tmp_path / "weather.csv"
    rows = [f"{name[:6]},{name}.png,{'rain' if '1' in name[6:] else 'day'}" for name in SCENES]
    table.write_text("\n".join(["name,file,condition", *rows]))
    chosen = ("--detector", ORACLE, "--set", "doubt=0.4", "--against", "prior:rows")
    places = ("--leave-out", GROUPS[0], "--conditions", table, "--limit", 5)

    run("camvid", camvid, *chosen, *places, "--montage", 0, "--out", tmp_path)

    written = metrics(tmp_path)
    scores = written["detectors"][ORACLE]
    assert (written["images"], written["left_out"]) == (5, [GROUPS[0]])
    assert scores["settings"] == DECISION | {"doubt": 0.4}
    assert scores["maxf_threshold"] == pytest.approx(0.2, abs=1e-4)
    assert set(scores["groups"]) == set(GROUPS[1:])
    assert set(scores["conditions"]) == {"day", "rain"}
    assert written["paired"]["against"] == "prior:rows"
    gain = written["paired"]["detectors"][ORACLE]["maxf"]
    assert 0 < gain["ci95"][0] <= gain["difference"] <= gain["ci95"][1]
    assert "--set doubt=0.4 --against prior:rows --leave-out" in written["command"]
    assert not list(tmp_path.glob("montage.*"))


# --- thresholds ----------------------------------------------------------------------------------


@pytest.mark.usefixtures("_no_page")
def test_a_config_holds_the_chosen_threshold_its_command_and_its_worth(camvid, tmp_path):
    chosen = ("--detector", "cpf:squares", "--detector", "prior:uniform", "--set", "isolated=keep")

    done = run("camvid", camvid, *chosen, "--tune", "--montage", 0, "--out", tmp_path)

    assert [path.name for path in tmp_path.glob("*.toml")] == ["cpf-squares.toml"]
    text = (tmp_path / "cpf-squares.toml").read_text()
    assert f"#   roadtorch evaluate camvid {camvid} --detector cpf:squares" in text
    assert "camvid dev, 6 images" in text
    assert "Each group at the threshold of the others: F 0." in text
    detector, values = DetectorOptions(config=tmp_path / "cpf-squares.toml").name_and_values()
    assert (detector, values["isolated"]) == ("cpf:squares", "keep")
    settings = load_detector(detector, **values).settings
    assert settings.model_dump(mode="json", exclude_none=True) == values
    header, row, _, closing = done.stdout.splitlines()[-4:]
    assert closing == f"All columns, charts and images: {tmp_path / 'report.html'}"
    assert header.split()[:5] == ["detector", "default", "F", "at", "default"]
    name, _, f_default, threshold, f, *_ = row.split()
    assert (name, threshold) == ("cpf:squares", f"{values['threshold']:.3f}")
    assert f": F {f_default}." in text
    assert float(f_default) < float(f)


# --- weights and corrections ---------------------------------------------------------------------


@pytest.mark.usefixtures("_no_page")
def test_weights_are_scored_on_corrections_beside_the_detector_they_began_with(tmp_path):
    images, corrections = tmp_path / "streets", tmp_path / "corrections"
    for seed in range(3):
        write_image(images / f"{seed}.png", scene := render_scene(seed, 48, 64))
        labels = np.where(scene.road.numpy(), 1, 2).astype(np.uint8)
        head = LogHeader(image=f"../streets/{seed}.png", height=48, width=64)
        EventLog(log_path(corrections, f"{seed}.png"), head).add(make_import_event(labels))
    network = BackboneNetwork(SMALL_BACKBONE)
    weights = tmp_path / "mine" / "weights.safetensors"
    weights.parent.mkdir()
    save_network(weights, network, {"corrections": [{"images": 7, "pixels": 9}]})

    done = run("corrections", corrections, "--detector", weights, "--against", "prior:uniform",
               "--out", tmp_path, "--montage", 0)  # fmt: skip

    assert done.exit_code == 0
    assert "mine-weights was trained on 7 images corrected by hand" in done.stderr
    written = metrics(tmp_path)
    assert (written["dataset"], written["images"]) == ("corrections", 3)
    assert written["paired"]["against"] == "prior:uniform"
    assert "maxf" in written["paired"]["detectors"]["mine-weights"]


# --- errors --------------------------------------------------------------------------------------


@pytest.mark.usefixtures("_no_page")
def test_a_broken_image_is_listed_and_the_rest_is_scored(tmp_path):
    out, root = tmp_path / "out", write_set(tmp_path / "camvid")
    (root / "train" / "0001TP_0.png").write_bytes(b"")

    result = run("camvid", root, "--detector", "prior:rows", "--montage", 0, "--out", out)

    assert result.exit_code == 1
    assert "failed: 0001TP_0:" in result.stderr
    written = metrics(out)
    assert written["images"] == 5
    assert [failure["image"] for failure in written["failed"]] == ["0001TP_0"]


@pytest.mark.parametrize(
    "words", [("--tune",), ("--submit",), ("--submit", "--out", "out"), ("--detector", "fusoin")]
)
def test_conflicting_options_are_refused(call: Call, camvid: Path, words: tuple[str]):
    done = call("evaluate", "camvid", camvid, *words)

    assert done.exit_code == 2
    assert done.stderr.startswith("roadtorch: error: ")
    assert done.stderr.count("\n") == 1


def test_a_folder_that_cannot_be_written_is_refused_before_the_run(camvid, tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    monkeypatch.setattr(scoring, "ItemTask", None)  # must not be reached

    with pytest.raises(InputError, match="out: cannot be written: Permission denied"):
        run("camvid", camvid, "--detector", "prior:rows", "--out", tmp_path / "out")


# --- maps ----------------------------------------------------------------------------------------


def test_a_few_maps_are_counted_and_their_failures_are_one_line(
    camvid: Path, tmp_path: Path, call: Call
) -> None:
    for name in list(SCENES)[:2]:
        Image.fromarray(SCENES[name].road.numpy().astype(np.uint8)).save(tmp_path / f"{name}.png")

    result = call("evaluate", "camvid", camvid, "--detector", tmp_path)

    assert result.exit_code == 1
    assert f"2 of {len(SCENES)} images were scored" in result.stdout
    assert result.stdout.split("F of mask")[1].split("\n")[1].split()[1] == "1.000"
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"failed: {len(SCENES) - 2} images, the first ")


# --- maps of infer --------------------------------------------------------------------------------


@pytest.mark.usefixtures("_no_page")
@pytest.mark.parametrize("kinds", ["likelihood,mask", "npy"])
def test_maps_score_like_the_detector(camvid: Path, tmp_path: Path, call: Call, kinds: str) -> None:
    maps, out, detector = tmp_path / "maps", tmp_path / "out", "fusion:untrained"
    images = (camvid / "train", camvid / "val")
    call("infer", *images, "--detector", detector, "--jobs", 1, "--out", maps, "--save", kinds)

    run("camvid", camvid, "--detector", detector, "--detector", maps, "--montage", 0, "--out", out)

    written = metrics(out)["detectors"]
    from_maps, direct = written["maps:maps"], written[detector]
    assert from_maps["threshold_default"] == direct["threshold_default"]
    for key in ("iou_mask", "f_mask"):
        assert from_maps[key] == direct[key], key
