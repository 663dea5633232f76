"""The pass over the pictures, thresholds chosen on other drives, and the figures."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import pytest
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Item
from roadtorch.detector import Detection
from roadtorch.evaluation import boundary, floors, metrics, runner, summary
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.runner import Plan
from roadtorch.evaluation.tally import Score, Tally
from roadtorch.report import screen
from roadtorch.scenes import render_scene, write_camvid

DRIVES = ("0001TP", "0006R0", "0016E5")


@pytest.fixture(scope="module")
def scenes() -> dict[str, object]:
    return {f"{DRIVES[i % 3]}_{i}": render_scene(i, 48, 64) for i in range(6)}


@pytest.fixture(scope="module")
def dataset(scenes, tmp_path_factory) -> Dataset:
    root = tmp_path_factory.mktemp("camvid")
    write_camvid(root, "train", scenes)
    return open_dataset("camvid", root, "train")


def looking(likelihood, **cues) -> runner.Look:
    """A detector that answers with a function of the item's name."""

    def look(image, item):
        values = likelihood(item.name).to(torch.float32)
        return Detection(values, values >= 0.5, {k: v(item.name) for k, v in cues.items()})

    return look


def tally(dataset: Dataset, look: runner.Look) -> Tally:
    total = Tally()
    for item in dataset.items:
        result = runner.score_item(Plan(dataset, {}), {"it": look}, item)
        assert not result.failure
        total.add(item, result.scores["it"])
    return total


def counts_of(road_levels: dict[int, int], other_levels: dict[int, int], levels=11) -> RoadCounts:
    road, other = torch.zeros(levels, dtype=torch.int64), torch.zeros(levels, dtype=torch.int64)
    for part, chosen in ((road, road_levels), (other, other_levels)):
        for level, number in chosen.items():
            part[level] = number
    return RoadCounts(road, other)


# --- figures -------------------------------------------------------------------------------------


def test_a_perfect_map_scores_one_and_an_inverted_one_does_not(dataset, scenes):
    perfect = summary.summarise(tally(dataset, looking(lambda n: scenes[n].road)), 0.5)
    inverted = summary.summarise(tally(dataset, looking(lambda n: ~scenes[n].road)), 0.5)

    for key in (
        "maxf",
        "iou",
        "iou_mask",
        "f_mask",
        "auc_pooled",
        "auc_mean",
        "auc_vertical",
        "ap",
    ):
        assert perfect[key] == pytest.approx(1, abs=1e-9)
    assert perfect["boundary_f"] == pytest.approx({"0.0025": 1, "0.005": 1, "0.0075": 1})
    for key in ("brier", "ece", "eer", "eer_vertical"):
        assert perfect[key] == pytest.approx(0, abs=1e-9)
    assert perfect["pooled"]["maxf"] == pytest.approx(1, abs=1e-9)
    assert perfect["groups"]["0001TP"]["working_point"]["fpr"] == 0
    assert inverted["brier"] == 1
    assert inverted["eer"] == 1
    assert inverted["auc_pooled"] == 0
    assert inverted["iou_mask"] == 0
    assert inverted["maxf"] < 0.75


def test_headline_is_the_mean_over_drives_of_pooled_counts(dataset, scenes):
    generator = torch.Generator().manual_seed(0)
    noise = {name: torch.rand(48, 64, generator=generator) for name in scenes}
    found = tally(dataset, looking(lambda n: (0.4 * scenes[n].road + noise[n]) / 1.4))

    figures = summary.summarise(found, 0.5)

    by_hand = []
    for drive in DRIVES:
        counts = [
            metrics.count_levels(
                (0.4 * scenes[n].road + noise[n]) / 1.4, scenes[n].road, ~scenes[n].void
            )
            for n in scenes
            if n.startswith(drive)
        ]
        by_hand.append(float(metrics.max_f(counts[0] + counts[1])[0]))
        assert figures["groups"][drive]["maxf"] == pytest.approx(by_hand[-1])
    assert figures["maxf"] == pytest.approx(sum(by_hand) / 3)
    everything = found.road["0001TP"] + found.road["0006R0"] + found.road["0016E5"]
    assert figures["pooled"]["maxf"] == pytest.approx(float(metrics.max_f(everything)[0]))
    assert figures["pooled"]["images"] == 6


def test_void_is_never_counted(dataset, scenes):
    wrong_in_void = tally(dataset, looking(lambda n: scenes[n].road | scenes[n].void))

    assert summary.summarise(wrong_in_void, 0.5)["iou"] == 1


def test_an_image_without_road_is_skipped_and_counted_in_the_mean_auc():
    total = Tally()
    total.add(item("a"), score({5: 3}, {2: 3}, seconds=0.1))
    total.add(item("b"), score({}, {2: 3}, seconds=0.3))

    figures = summary.summarise(total, 0.5)

    assert figures["auc_mean"] == 1
    assert figures["auc_vertical"] == 1
    assert figures["auc_images_skipped"] == 1
    assert figures["ms_per_image"] == pytest.approx(200)


def item(name: str) -> Item:
    return Item(name, Path(name), Path(name), "x")


def score(road: dict[int, int], other: dict[int, int], seconds: float) -> Score:
    hits, rest = (torch.tensor(sum(part.values())) for part in (road, other))
    none = torch.tensor(0)
    mask = metrics.Decisions(hits, none, none, rest)
    border = torch.zeros((len(boundary.TOLERANCES), 4), dtype=torch.int64)
    return Score(counts_of(road, other), mask, border, None, None, seconds)


# --- thresholds ----------------------------------------------------------------------------------


def test_held_out_thresholds_never_see_their_own_drive():
    # Two drives part cleanly at level 4, the third at level 8: peeking would move them.
    low, high = counts_of({4: 10}, {3: 10}), counts_of({8: 10}, {7: 10})

    found = summary.held_out_thresholds({"a": low, "b": low, "c": high})

    assert found["c"] == pytest.approx(0.4)
    changed = summary.held_out_thresholds({"a": low, "b": low, "c": counts_of({2: 9}, {1: 9})})
    assert changed["c"] == found["c"]
    assert changed["a"] != found["a"]


def test_drives_weigh_the_same_in_the_choice():
    # Pooled, the big drive alone would decide; averaged, two small ones outvote it.
    big, small = counts_of({8: 10_000}, {7: 10_000}), counts_of({4: 10}, {3: 10, 4: 0})
    small = small + counts_of({5: 10}, {})

    assert summary.shared_threshold({"a": big, "b": small, "c": small}) == pytest.approx(0.4)


def test_where_thresholds_come_from():
    counts = counts_of({4: 10}, {3: 10})

    assert summary.choose_thresholds({"all": counts}, 0.6, None)[1] == {"all": 0.6}
    assert summary.choose_thresholds({"all": counts}, 0.6, 0.2)[1] == {"all": 0.2}
    assert summary.choose_thresholds({"a": counts, "b": counts}, 0.6, None)[1]["a"] == 0.4


def test_iou_is_taken_at_the_held_out_threshold(dataset, scenes):
    def likelihood(name):  # one drive's road is paler than the others' background
        scale = 0.3 if name.startswith("0001TP") else 1.0
        return scale * (0.4 + 0.6 * scenes[name].road)

    figures = summary.summarise(tally(dataset, looking(likelihood)), 0.5)

    dusk = figures["groups"]["0001TP"]
    assert dusk["maxf"] == pytest.approx(1)
    assert dusk["threshold"] > 0.3
    assert dusk["iou"] == 0


# --- layout --------------------------------------------------------------------------------------


def test_layout_recalls_by_drive_over_all_and_labelled_pixels(dataset, scenes):
    def potentials(name):  # horizontal is never named: it goes to vertical
        truth = scenes[name].layout
        return torch.stack([truth == 0, truth != 0, torch.zeros_like(truth)]).float()

    def labels(name):  # abstain on horizontal instead
        truth = scenes[name].layout
        return torch.where(truth == 2, 255, truth)

    road = looking(lambda n: scenes[n].road, layout=potentials, layout_labels=labels)
    figures = summary.summarise(tally(dataset, road), 0.5)

    layout = figures["groups"]["0001TP"]["layout"]
    assert [layout[c] for c in metrics.LAYOUT_CLASSES] == [1, 1, 0]
    assert figures["layout"]["mean"] == pytest.approx(2 / 3)
    assert math.isnan(layout["labelled"]["horizontal"])
    assert layout["labelled"]["mean"] == 1
    assert 0.2 < layout["labelled_share"] < 0.8
    assert figures["layout"]["confusion"]["horizontal"]["vertical"] == 1
    assert "drive" in screen.layout_table({"it": figures})


# --- floors --------------------------------------------------------------------------------------


def test_the_mean_mask_is_the_other_drives(dataset, scenes):
    found = floors.means_of_others(floors.road_shares(dataset))

    shares = {}
    for drive in DRIVES:
        own = [scene for name, scene in scenes.items() if name.startswith(drive)]
        road = torch.stack([scene.road & ~scene.void for scene in own]).double().sum(0)
        seen = torch.stack([~scene.void for scene in own]).double().sum(0)
        shares[drive] = road / seen.clamp(min=1e-9)
    expected = (shares["0006R0"] + shares["0016E5"]) / 2
    assert torch.allclose(found["0001TP"], expected)


def test_one_drive_alone_teaches_nothing(dataset):
    alone = runner.every_kth(dataset, 1)

    assert floors.means_of_others(floors.road_shares(alone)) == {}


def test_a_mask_from_elsewhere_is_brought_to_the_size_of_the_image(dataset):
    item = dataset.items[0]
    ramp = torch.linspace(0, 1, 10, dtype=torch.float64)[:, None].expand(10, 8)

    found = runner.mean_detection(torch.zeros(3, 48, 64), item, {"0001TP": ramp})

    assert found.likelihood.shape == (48, 64)
    assert found.likelihood[0].max() < 0.1
    assert found.likelihood[-1].min() > 0.9


# --- the pass ------------------------------------------------------------------------------------


def test_results_keep_the_order_of_the_set_and_every_kth_spreads(dataset):
    plan = Plan(runner.every_kth(dataset, 3), {"prior:rows": {}})

    names = [result.item.name for result in runner.run(plan)]

    assert names == [dataset.items[i].name for i in (0, 2, 4)]


def test_items_that_are_done_are_not_done_again(dataset):
    done = {item.name for item in dataset.items[1:]}

    results = list(runner.run(Plan(dataset, {"prior:rows": {}}), done=done))

    assert [result.item for result in results] == [dataset.items[0]]


def test_a_broken_image_counts_for_no_detector(dataset, tmp_path: Path, scenes):
    write_camvid(tmp_path, "train", scenes)
    (tmp_path / "train" / "0006R0_1.png").write_bytes(b"not a picture")
    broken = open_dataset("camvid", tmp_path, "train")

    results = list(runner.run(Plan(broken, {"prior:rows": {}, "prior:triangle": {}})))

    failed = [result for result in results if result.failure]
    assert [result.item.name for result in failed] == ["0006R0_1"]
    assert not failed[0].scores
    assert all(len(result.scores) == 2 for result in results if not result.failure)


def test_a_detector_that_breaks_is_named(dataset):
    def look(image, item):
        raise ZeroDivisionError("no road")

    result = runner.score_item(Plan(dataset, {}), {"mine": look}, dataset.items[0])

    assert result.failure == "mine: ZeroDivisionError: no road"


def test_two_processes_give_the_results_of_one(dataset):
    masks = floors.means_of_others(floors.road_shares(dataset))
    plan = Plan(dataset, {"prior:rows": {}, "prior:triangle": {}}, masks)

    one, two = list(runner.run(plan)), list(runner.run(plan, jobs=2))

    assert [result.item for result in one] == [result.item for result in two]
    for first, second in zip(one, two, strict=True):
        assert first.scores.keys() == second.scores.keys() == {*plan.detectors, floors.MEAN}
        for name, score in first.scores.items():
            assert torch.equal(score.road.road, second.scores[name].road.road)
            assert torch.equal(score.road.other, second.scores[name].road.other)


# --- views ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LowerHalf:
    """A view that sees the lower half of a picture, twice as large."""

    name: ClassVar[str] = "the lower half"

    def __call__(self, item: Item, values: torch.Tensor) -> torch.Tensor:
        lower = values[..., values.shape[-2] // 2 :, :]
        return lower.repeat_interleave(2, -1).repeat_interleave(2, -2)


def test_maps_and_truth_are_scored_in_the_view_of_the_set(dataset, scenes):
    viewed = replace(dataset, view=LowerHalf())

    def above(name):  # wrong in the upper half alone
        likelihood = scenes[name].road.clone()
        likelihood[:24] = ~likelihood[:24]
        return likelihood

    plain, seen = (summary.summarise(tally(one, looking(above)), 0.5) for one in (dataset, viewed))

    assert plain["maxf"] < 0.9
    assert seen["maxf"] == pytest.approx(1)
    first = dataset.items[0].name
    whole = scenes[first]
    counted = tally(replace(viewed, items=dataset.items[:1]), looking(above)).rows[0].road
    assert int(counted.road.sum()) == 4 * int((whole.road & ~whole.void)[24:].sum())


def test_the_levels_of_the_set_are_those_that_are_told_apart(dataset):
    pale = looking(lambda name: torch.full((48, 64), 0.4))
    two = replace(dataset, levels=2)

    assert tally(two, pale).road["0001TP"].levels == 2
    assert summary.summarise(tally(two, pale), 0.5)["maxf_threshold"] == 0


# --- rendered report -----------------------------------------------------------------------------


def test_columns_line_up():
    assert screen.align([["a", "b"], ["long", "1.5"]]) == "a       b\nlong  1.5"
