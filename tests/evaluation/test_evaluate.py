"""`evaluate` from Python: detectors, thresholds, images."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from roadtorch.base.atomic import write_json
from roadtorch.base.errors import ConfigError, DatasetError, InputError, UnscorableError
from roadtorch.base.image import read_image
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, leave_out
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics, scoring
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.report.files import build_document
from roadtorch.evaluation.result import Evaluation
from roadtorch.evaluation.tally import UNGROUPED
from roadtorch.testing.scenes import write_image
from tests.data.conftest import write
from tests.oracle import DECISION, GROUPS, ORACLE, SCENES, register_oracle, write_set


@pytest.fixture(scope="module")
def camvid(tmp_path_factory) -> Dataset:
    register_oracle()
    return open_dataset("camvid", write_set(tmp_path_factory.mktemp("set") / "camvid"))


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Dataset:
    """Write the same scenes as a folder of images and masks, without groups."""
    root = tmp_path_factory.mktemp("set") / "folder"
    (root / "masks").mkdir(parents=True)
    for name, scene in SCENES.items():
        write_image(root / "images" / f"{name}.png", scene)
        mask = torch.where(scene.void, 127, 255 * scene.road).to(torch.uint8)
        cv2.imwrite(str(root / "masks" / f"{name}.png"), mask.numpy())
    return open_dataset("folder", root)


@pytest.fixture(scope="module")
def evaluation(camvid) -> Evaluation:
    return evaluate(camvid, [ORACLE], settings={"doubt": 0.2})


def test_metrics_json_has_every_measure_under_its_key(evaluation):
    content = build_document(evaluation, "the command")

    section, scores = content["detectors"][ORACLE], evaluation.detectors[ORACLE]
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["command"] == "the command"
    assert section["maxf"] == scores.headline["maxf"]
    assert section["layout"]["void_as_vertical"]["mean"] <= 1
    assert section["pooled"]["boundary_f"].keys() == {"0.00375", "0.0075"}
    assert section["ci95"]["layout_mean"] == [1, 1]
    assert section["maxf_threshold"] == scores.best_threshold
    assert {name: part["baseline"] for name, part in content["detectors"].items()} == {
        ORACLE: False, "prior:rows": True, "prior:triangle": True, "prior:mean": True
    }  # fmt: skip
    assert section["settings"] == DECISION | {"doubt": 0.2}
    assert content["detectors"]["prior:rows"]["settings"] == DECISION
    assert content["paired"]["against"] == ORACLE
    assert content["paired"]["detectors"]["prior:rows"]["maxf"]


def test_the_detector_to_compare_with_joins_the_run(camvid):
    joined = evaluate(camvid, ["prior:uniform"], against=ORACLE)
    alone = evaluate(camvid, ["prior:uniform", ORACLE], against=ORACLE, with_baselines=False)

    assert joined.comparison.against == alone.comparison.against == ORACLE
    assert set(alone.detectors) == {"prior:uniform", ORACLE}
    changes = (run.comparison.differences["prior:uniform"] for run in (joined, alone))
    assert next(changes) == next(changes)


def test_sets_without_groups_use_the_default_or_another_threshold(
    evaluation, camvid, plain, tmp_path
):
    write_json(tmp_path / "metrics.json", build_document(evaluation, ""))
    settings = {"doubt": 0.2}

    by_default = evaluate(plain, [ORACLE], settings=settings).detectors
    by_earlier = evaluate(
        plain, [ORACLE], settings=settings, mean_from=camvid,
        threshold_from=tmp_path / "metrics.json",
    ).detectors  # fmt: skip

    assert by_default[ORACLE].groups == by_default[ORACLE].pooled == {}
    assert by_default[ORACLE].thresholds == {UNGROUPED: 0.5}
    assert "prior:mean" not in by_default
    assert by_earlier[ORACLE].threshold_from == "an earlier run"
    for name in (ORACLE, "prior:mean", "prior:rows"):
        assert by_earlier[name].headline["threshold"] == evaluation.detectors[name].best_threshold


def test_likelihood_maps_are_scored_and_a_missing_one_fails_its_image_alone(camvid, tmp_path):
    for name in list(SCENES)[1:]:
        road = (SCENES[name].road * 255).to(torch.uint8)
        cv2.imwrite(str(tmp_path / f"{name}.png"), road.numpy())

    run = evaluate(camvid, [f"net={tmp_path}"])

    assert set(run.detectors) == {"maps:net", "prior:rows", "prior:triangle", "prior:mean"}
    assert run.detectors["maps:net"].headline["maxf"] == pytest.approx(1)
    assert run.detectors["maps:net"].headline["iou_mask"] == 1
    missing = next(iter(SCENES))
    assert [failure.image for failure in run.failures] == [missing]
    assert f"maps:net: {tmp_path / missing}.png: is missing" in run.failures[0].reason
    assert run.images == 5


def test_maps_may_have_the_folders_of_the_set(plain, tmp_path):
    for name, scene in SCENES.items():
        write(tmp_path / f"images/{name}.png", 255 * scene.road.numpy().astype(np.uint8))

    run = evaluate(plain, [f"net={tmp_path}"])

    assert run.failures == []
    assert run.detectors["maps:net"].headline["iou_mask"] == 1


# --- what is refused -----------------------------------------------------------------------------

FIGURES = f'{{"detectors": {{"{ORACLE}": {{"maxf_threshold": %s}}}}}}'
OUT_OF_RANGE = [FIGURES % value for value in ("1e308", "-0.1", "NaN", "Infinity", "[]")]


@pytest.mark.parametrize("text", [*OUT_OF_RANGE, "[1]", None])
def test_another_file_than_a_metrics_json_is_refused(camvid, tmp_path, text):
    earlier = tmp_path / "metrics.json"
    if text is not None:
        earlier.write_text(text)

    with pytest.raises(DatasetError, match=r"metrics\.json: cannot be read"):
        evaluate(camvid, [ORACLE], threshold_from=earlier)


@pytest.mark.parametrize(
    ("detector", "options", "message"),
    [
        (ORACLE, {"threshold_from": "metrics.json"}, "with other settings"),
        ("prior:uniform", {"threshold_from": "metrics.json"}, "no threshold for prior:uniform"),
        (ORACLE, {"settings": {"duobt": 1}}, r"duobt.*doubt"),
        (ORACLE, {"mean_from": "camvid"}, "for sets without groups"),
        ("prior:rows", {"against": "prior:*"}, "is not a single detector"),
        ("nothing*", {}, "unknown detector"),
        ("test-oracel", {}, ORACLE),
        ("prior:rows", {"runtime": "onnxruntime"}, "--runtime: has no effect"),
        (".", {"settings": {"threshold": 0.5}}, "--set, --camera: have no effect on maps"),
    ],
)
def test_what_can_be_refused_is_refused_before_the_run(
    evaluation, camvid, tmp_path, monkeypatch, detector, options, message
):
    monkeypatch.setattr(scoring, "ItemTask", None)  # must not be reached
    write_json(tmp_path / "metrics.json", build_document(evaluation, ""))
    values = {"metrics.json": tmp_path / "metrics.json", "camvid": camvid}
    options = {key: values.get(str(value), value) for key, value in options.items()}

    with pytest.raises(ConfigError, match=message):
        evaluate(camvid, [detector], **options)


@pytest.mark.parametrize(
    ("masks", "maps", "error", "message"),
    [
        ({"a": 0}, None, UnscorableError, "no label has any road"),
        ({"a": 0, "b": 1}, {"a": 0, "b": math.nan}, UnscorableError,
         r"no label has any road in the 1 .*b\.npy: holds NaN"),
        ({"a": 1}, {"a": math.nan}, DatasetError, r"none of the 1 images .*a\.npy: holds NaN"),
        ({"a": 1}, {}, InputError, "has a likelihood map of none of 1 images"),
    ],
)  # fmt: skip
def test_a_set_that_cannot_be_scored_is_one_error(tmp_path, masks, maps, error, message):
    for name, level in masks.items():
        for folder in ("images", "masks"):
            write(tmp_path / f"{folder}/{name}.png", np.full((16, 16), 255 * level, np.uint8))
    (tmp_path / "maps").mkdir()
    for name, level in (maps or {}).items():
        np.save(tmp_path / f"maps/{name}.npy", np.full((16, 16), float(level)))
    detector = "prior:rows" if maps is None else str(tmp_path / "maps")

    with pytest.raises(error, match=message) as caught:
        evaluate(open_dataset("folder", tmp_path), [detector])
    assert type(caught.value) is error


def test_at_least_one_group_has_to_be_scored(camvid):
    with pytest.raises(DatasetError, match="all groups are left out"):
        evaluate(leave_out(camvid, [GROUPS[0]]), ["prior:rows"], limit=1)


# --- groups left out, conditions -----------------------------------------------------------------


def without_times(content):
    if isinstance(content, dict):
        return {key: without_times(part) for key, part in content.items() if key != "ms_per_image"}
    return content


def test_a_group_that_is_left_out_is_scored_and_changes_no_other_score(camvid):
    out = GROUPS[2]
    remaining = tuple(item for item in camvid.items if item.group != out)
    whole = evaluate(camvid, ["grey-uniformity"])

    run = evaluate(leave_out(camvid, [out]), ["grey-uniformity"])
    alone = evaluate(replace(camvid, items=remaining), ["grey-uniformity"])

    scores, expected = (
        without_times(build_document(part, ""))["detectors"] for part in (run, alone)
    )
    for name, part in scores.items():
        assert set(part.pop("left_out")) == {out}
        assert expected[name].pop("left_out") == {}
        assert part == expected[name]
    assert (run.groups, run.left_out, run.images) == (list(GROUPS[:2]), [out], 6)
    # It is scored at the threshold that the others share, and by all that needs none as before.
    grey = run.detectors["grey-uniformity"]
    assert grey.group(out)["threshold"] == grey.best_threshold
    assert grey.group(out)["maxf"] == whole.detectors["grey-uniformity"].group(out)["maxf"]
    assert build_document(run, "")["left_out"] == [out]


def test_a_condition_is_scored_on_its_images_whatever_their_group(camvid):
    rainy = {"0001TP_0": ("rain",), "0006R0_1": ("rain", "dusk"), "0016E5_2": ("dusk",)}
    items = tuple(replace(item, conditions=rainy.get(item.name, ())) for item in camvid.items)
    chosen = tuple(item for item in camvid.items if "rain" in rainy.get(item.name, ()))

    name = "grey-uniformity"
    scores = evaluate(replace(camvid, items=items), [name]).detectors[name]
    alone = evaluate(replace(camvid, items=chosen), [name]).detectors[name].pooled

    rain = scores.conditions["rain"]
    assert set(scores.conditions) == {"rain", "dusk"}
    assert rain["images"] == 2
    for key in ("f_mask", "iou_mask", "auc_mean", "boundary_f/0.0075"):
        assert rain[key] == pytest.approx(alone[key], abs=1e-12), key
    for key in ("maxf", "auc_pooled", "ap", "brier", "ece"):  # on 8-bit maps
        assert rain[key] == pytest.approx(alone[key], abs=0.01), key
    assert {"threshold", "trust/auc"}.isdisjoint(rain)
    f = []
    for item in chosen:
        truth, detection = camvid.truth(item), load_detector(name).detect(read_image(item.image))
        counts = metrics.count_levels(detection.likelihood, truth.road, truth.valid, 256)
        f.append(metrics.confusion_at(counts, scores.thresholds[item.group or ""]))
    assert rain["f"] == pytest.approx(float(metrics.f_measure(f[0] + f[1])))


def test_a_condition_without_a_scored_image_has_no_scores(camvid, tmp_path):
    root = write_set(tmp_path / "camvid")
    first = camvid.items[0]
    (root / "train" / first.image.name).write_bytes(b"x")
    broken = open_dataset("camvid", root)
    items = (replace(broken.items[0], conditions=("fog",)), *broken.items[1:])

    run = evaluate(replace(broken, items=items), ["prior:rows"])

    assert run.conditions == []
    assert "conditions" not in build_document(run, "")["detectors"]["prior:rows"]
