"""From counts to scores: groups, their means, thresholds chosen on other groups."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from scipy.stats import spearmanr

from roadtorch.data.dataset import LabelledItem
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation import boundary, metrics
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Contender
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.report.files import IMAGE_COLUMNS, image_rows
from roadtorch.evaluation.result import (
    Comparison,
    Evaluation,
    choose_thresholds,
    held_out_thresholds,
    shared_threshold,
)
from roadtorch.evaluation.tally import ImageCounts, Tally
from roadtorch.layout.classes import CLASS_NAMES
from tests.evaluation.conftest import GROUPS, answering, scores_of, tally_of


def counts_of(road_levels: dict[int, int], other_levels: dict[int, int], levels=11) -> RoadCounts:
    road, background = torch.zeros(2, levels, dtype=torch.int64)
    for part, chosen in ((road, road_levels), (background, other_levels)):
        for level, number in chosen.items():
            part[level] = number
    return RoadCounts(road, background)


# --- scores -------------------------------------------------------------------------------------


def test_a_perfect_map_scores_one_and_an_inverted_one_does_not(dataset, scenes):
    perfect = scores_of(tally_of(dataset, answering(lambda n: scenes[n].road)))
    inverted = scores_of(tally_of(dataset, answering(lambda n: ~scenes[n].road)))

    for measure in MEASURES:
        if measure.key in perfect.headline and not measure.key.startswith("layout/"):
            ideal = {"higher": 1, "lower": 0}.get(measure.better or "")
            assert ideal is None or measure.get(perfect.headline) == pytest.approx(ideal, abs=1e-9)
    assert perfect.pooled["maxf"] == pytest.approx(1, abs=1e-9)
    assert inverted.headline["brier"] == 1
    assert inverted.headline["auc_pooled"] == 0
    assert inverted.headline["iou_mask"] == 0
    assert inverted.headline["maxf"] < 0.75


def test_headline_is_the_mean_over_groups_of_pooled_counts(dataset, scenes):
    generator = torch.Generator().manual_seed(0)
    noise = {name: torch.rand(48, 64, generator=generator) for name in scenes}
    tally = tally_of(dataset, answering(lambda n: (0.4 * scenes[n].road + noise[n]) / 1.4))

    scores = scores_of(tally)

    by_hand = []
    for group in GROUPS:
        counts = [
            metrics.count_levels(
                (0.4 * scenes[n].road + noise[n]) / 1.4, scenes[n].road, ~scenes[n].void
            )
            for n in scenes
            if n.startswith(group)
        ]
        by_hand.append(float(metrics.max_f(counts[0] + counts[1])[0]))
        assert scores.groups[group]["maxf"] == pytest.approx(by_hand[-1])
    assert scores.headline["maxf"] == pytest.approx(sum(by_hand) / 3)
    everything = tally.road["0001TP"] + tally.road["0006R0"] + tally.road["0016E5"]
    assert scores.pooled["maxf"] == pytest.approx(float(metrics.max_f(everything)[0]))
    assert scores.pooled["images"] == 6


def test_an_image_without_road_is_skipped_in_the_mean_auc():
    total = Tally()
    item = LabelledItem("a", Path("a"), Path("a"), "x")
    total.add(item, score({5: 3}, {2: 3}, seconds=0.1))
    total.add(replace(item, name="b"), score({}, {2: 3}, seconds=0.3))

    scores = scores_of(total)

    assert scores.headline["auc_mean"] == 1
    assert scores.headline["ms_per_image"] == pytest.approx(200)


def score(road: dict[int, int], background: dict[int, int], seconds: float) -> ImageCounts:
    hits, negatives = (torch.tensor(sum(part.values())) for part in (road, background))
    none = torch.tensor(0)
    mask = metrics.ConfusionCounts(hits, none, none, negatives)
    border = torch.zeros((len(boundary.TOLERANCES), 4), dtype=torch.int64)
    return ImageCounts(counts_of(road, background), mask, border, None, seconds)


# --- thresholds ----------------------------------------------------------------------------------


def test_held_out_thresholds_never_see_their_own_group():
    # Two groups part cleanly at level 4, the third at level 8: peeking would move them.
    low, high = counts_of({4: 10}, {3: 10}), counts_of({8: 10}, {7: 10})

    thresholds = held_out_thresholds({"a": low, "b": low, "c": high})

    assert thresholds["c"] == pytest.approx(0.4)
    changed = held_out_thresholds({"a": low, "b": low, "c": counts_of({2: 9}, {1: 9})})
    assert changed["c"] == thresholds["c"]
    assert changed["a"] != thresholds["a"]


def test_groups_weigh_the_same_in_the_choice():
    # Pooled, the big group alone would decide; averaged, two small ones outvote it.
    big, small = counts_of({8: 10_000}, {7: 10_000}), counts_of({4: 10}, {3: 10, 4: 0})
    small = small + counts_of({5: 10}, {})

    assert shared_threshold({"a": big, "b": small, "c": small}) == pytest.approx(0.4)


def test_where_thresholds_come_from():
    counts = counts_of({4: 10}, {3: 10})

    contender = Contender("it", lambda _: NotImplemented, threshold=0.6)

    assert choose_thresholds(contender, {"all": counts})[1] == {"all": 0.6}
    assert choose_thresholds(replace(contender, earlier_threshold=0.2), {"all": counts})[1] == {
        "all": 0.2
    }
    assert choose_thresholds(contender, {"a": counts, "b": counts})[1]["a"] == 0.4


# --- layout --------------------------------------------------------------------------------------


def test_layout_recalls_by_group(dataset, scenes):
    def potentials(name):  # horizontal is never named: it goes to vertical
        truth = scenes[name].layout
        return torch.stack([truth == 0, truth != 0, torch.zeros_like(truth)]).float()

    road = answering(lambda n: scenes[n].road, layout=potentials)
    scores = scores_of(tally_of(dataset, road))

    group = scores.groups["0001TP"]
    assert [group[f"layout/{name}"] for name in CLASS_NAMES] == [1, 1, 0]
    assert scores.headline["layout/mean"] == pytest.approx(2 / 3)


# --- trust, calibration --------------------------------------------------------------------------


def trusting(scenes, trusts: Mapping[str, float | None]):
    """Return a detector that finds less of the road with each image, with these trusts."""
    order = {name: place for place, name in enumerate(scenes)}

    def look(image, item):
        mask = scenes[item.name].road.clone()
        mask[: 30 + 2 * order[item.name]] = False
        return Detection(mask.float(), mask, {}, trusts[item.name])

    return look


def test_trust_is_measured_on_all_images_together_and_by_group(dataset, scenes):
    knowing = {name: 1 - place / 10 for place, name in enumerate(scenes)}

    tally = tally_of(dataset, trusting(scenes, knowing))
    scores = scores_of(tally)
    blind = scores_of(tally_of(dataset, trusting(scenes, dict.fromkeys(scenes, 0.5)))).headline

    table = tally.table()
    f, trusts = metrics.f_measure(table.mask), torch.tensor([knowing[name] for name in table.names])
    correlation = scores.headline["trust/rank_correlation"]
    assert correlation == pytest.approx(spearmanr(trusts, f)[0])
    assert scores.headline["trust/error"] == pytest.approx(float((trusts - f).abs().mean()))
    assert scores.groups["0001TP"]["trust/rank_correlation"] == pytest.approx(1)
    assert math.isnan(scores.headline["trust/rank_correlation_within"])  # two images a group
    assert math.isnan(blind["trust/rank_correlation"])


def test_images_without_trust_are_left_out_and_detectors_without_any_have_no_score(dataset, scenes):
    first, *trusted = scenes
    trusts = {first: None, **dict.fromkeys(trusted, 0.9)}

    tally = tally_of(dataset, trusting(scenes, trusts))
    never = scores_of(tally_of(dataset, trusting(scenes, dict.fromkeys(scenes, None))))

    errors = (metrics.f_measure(tally.table(names=trusted).mask) - 0.9).abs()
    assert scores_of(tally).headline["trust/error"] == pytest.approx(float(errors.mean()))
    assert not any(key.startswith("trust/") for key in (*never.headline, *never.pooled))


# --- single images -----------------------------------------------------------------------------


def test_a_row_holds_f_and_iou_of_the_mask_and_its_trust(dataset, scenes):
    first = next(iter(scenes))

    def look(image, item):
        mask = torch.zeros(48, 64, dtype=torch.bool)
        mask[24:] = True
        return Detection(mask.float(), mask, {}, 0.625 if item.name == first else None)

    tally = tally_of(dataset, look)
    left_out = {GROUPS[1]: {}}
    scores = replace(scores_of(tally), left_out=left_out)
    run = Evaluation(dataset, {"it": scores}, Comparison("it", {}), tallies={"it": tally})
    rows = {row["image"]: row for row in image_rows(run)}

    road, valid = scenes[first].road & ~scenes[first].void, ~scenes[first].void
    hits, decided = int((road[24:]).sum()), int(valid[24:].sum())
    f, iou = (float(rows[first][key]) for key in ("f_mask", "iou_mask"))
    assert f == pytest.approx(2 * hits / (decided + int(road.sum())), abs=1e-6)
    assert iou == pytest.approx(hits / (decided + int(road.sum()) - hits), abs=1e-6)
    assert [row["trust"] for row in rows.values()] == ["0.625000", *[""] * 5]
    for row in rows.values():
        assert tuple(row) == IMAGE_COLUMNS
        assert row["status"] == ("left out" if row["group"] == GROUPS[1] else "ok")
