"""Contenders: names, files and folders, the mean mask of other groups, the row prior."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import ConfigError, InputError, WeightsError
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, subsample_dataset
from roadtorch.evaluation import metrics
from roadtorch.evaluation.methods import (
    collect_contenders,
    mean_masks,
    parse_contenders,
    resize_map,
)
from roadtorch.road.bayes import prior_rows
from roadtorch.testing.scenes import render_scene, write_image
from tests.evaluation.conftest import GROUPS
from tests.networks import write_random_network


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write weights, a config and a folder of maps to the working directory."""
    for name in ("mine", "theirs", "prior:rows"):
        (tmp_path / name).mkdir()
    write_random_network(tmp_path / "mine/weights.safetensors", 0)
    (tmp_path / "mine/a=b.toml").write_text('detector = "cpf"\nthreshold = 0.25\n')
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("text", "name", "detector"),
    [
        ("cpf:v2", "cpf:v2", "cpf:v2"),
        ("prior:rows", "prior:rows", "prior:rows"),  # though there is a folder of that name
        ("mine/weights.safetensors", "mine-weights", "fusion"),
        ("best=mine/weights.safetensors", "best", "fusion"),
        ("mine/a=b.toml", "mine-a=b", "cpf"),
        ("thresholds/cpf-v2", "thresholds-cpf-v2", "cpf:v2"),
        ("theirs", "maps:theirs", ""),
        ("./prior:rows", "maps:prior:rows", ""),
        ("net=theirs", "maps:net", ""),
    ],
)
def test_a_text_names_a_detector_a_file_or_a_folder(files, text, name, detector):
    (entry,) = parse_contenders(text)

    assert (entry.name, entry.detector) == (name, detector)
    if detector == "cpf":
        assert entry.threshold == 0.25


def test_settings_reach_what_has_a_detector_and_go_before_those_of_a_file(files):
    thresholds = [
        parse_contenders(text, {"threshold": 0.75})[0].threshold
        for text in ("cpf", "mine/a=b.toml", "theirs")
    ]

    assert thresholds == [0.75, 0.75, 0.5]


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (["front/0", "rear/0"], ""),
        (["0"], "0.png: would be the map of front/0 and of rear/0"),
        (["front/0", "rear/0", "0"], "0.png: would be the map of"),
    ],
)
def test_no_map_is_scored_for_two_images(files, dataset, names, problem):
    items = [
        replace(
            item, name=f"{camera}/0", image=files / camera / "0.png", label=files / camera / "0.png"
        )
        for item, camera in zip(dataset.items, ("front", "rear"), strict=False)
    ]
    for name in names:
        write_image(files / "theirs" / f"{name}.png", render_scene(0, 8, 8))
    (entry,) = parse_contenders("theirs")

    with pytest.raises(InputError, match=problem) if problem else nullcontext():
        entry.prepare(replace(dataset, root=files, items=tuple(items)))


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("fusoin", ConfigError, "unknown detector .*fusion"),
        ("no/such.safetensors", WeightsError, "such.safetensors"),
        *((text, ConfigError, "is not a weight file") for text in ("a/b", "net=nothing", "x.txt")),
        *(
            (f"{name}=theirs", ConfigError, "cannot be a file name")
            for name in ("a/../b", "a\\b", "\n")
        ),
        ("nothing*", ConfigError, "unknown detector"),
    ],
)
def test_a_text_that_names_nothing_is_refused(files, text, error, message):
    with pytest.raises(error, match=message):
        parse_contenders(text)


def test_a_detector_is_scored_once_and_two_of_one_name_are_refused(files, dataset):
    names = [
        entry.name
        for entry in collect_contenders(dataset, ["prior:t*", "prior:rows", "prior:*"], {})
    ]

    assert names == ["prior:triangle", "prior:rows", "prior:uniform", "prior:mean"]
    with pytest.raises(ConfigError, match="names two detectors"):
        collect_contenders(dataset, ["x=mine/a=b.toml", "x=mine/weights.safetensors"], {})


# --- the baseline that data sets teach -----------------------------------------------------------


def test_the_mean_mask_is_the_other_groups(dataset, scenes):
    shares = {}
    for group in GROUPS:
        members = [scene for name, scene in scenes.items() if name.startswith(group)]
        road = torch.stack([scene.road & ~scene.void for scene in members]).double().sum(0)
        valid = torch.stack([~scene.void for scene in members]).double().sum(0)
        shares[group] = road / valid.clamp(min=1e-9)

    mask = mean_masks(dataset)["0001TP"]

    assert torch.allclose(mask, (shares["0006R0"] + shares["0016E5"]) / 2)
    assert mean_masks(subsample_dataset(dataset, 1)) == {}  # one group alone teaches nothing


def test_a_mask_from_elsewhere_is_brought_to_the_size_of_the_image(dataset):
    single = subsample_dataset(dataset, 1)

    *_, mean = collect_contenders(single, (), {}, mean_from=dataset)
    detection = mean.prepare(single)(torch.zeros(3, 24, 32), single.items[0])

    assert mean.name == "prior:mean"
    assert detection.likelihood.shape == (24, 32)
    assert detection.likelihood[0].max() < 0.1
    assert detection.likelihood[-1].mean() > 0.5


# --- on real labels ------------------------------------------------------------------------------


def baseline_scores(dataset: Dataset, maps: dict | None = None) -> dict[str, float]:
    """Compute MaxF by group of the row prior, or of a map for each group, from the labels alone."""
    counts: dict[str, metrics.RoadCounts] = {}
    for item in dataset.items:
        truth, group = dataset.truth(item), item.group or ""
        size = truth.road.shape
        likelihood = resize_map(maps[group], size) if maps else prior_rows(*size)
        more = metrics.count_levels(likelihood, truth.road, truth.valid)
        counts[group] = counts[group] + more if group in counts else more
    return {group: float(metrics.max_f(part)[0]) for group, part in counts.items()}


@pytest.mark.data
def test_row_prior_on_camvid_by_group(data_root):
    scores = baseline_scores(open_dataset("camvid", data_root / "camvid"))

    assert scores == pytest.approx({"0001TP": 0.834, "0006R0": 0.905, "0016E5": 0.852}, abs=6e-4)


@pytest.mark.data
def test_row_prior_and_camvids_mean_mask_on_idd(data_root):
    idd = open_dataset("idd-lite", data_root / "idd_lite")
    few = subsample_dataset(open_dataset("camvid", data_root / "camvid"), 100)  # for speed

    assert baseline_scores(idd)[""] == pytest.approx(0.813, abs=6e-4)
    assert baseline_scores(idd, mean_masks(idd, few))[""] == pytest.approx(0.834, abs=4e-3)
