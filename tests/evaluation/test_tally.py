"""Counts of single images, and their sums."""

import pickle
from dataclasses import dataclass, replace
from typing import ClassVar

import pytest
import torch

from roadtorch.data.dataset import LabelledItem, subsample_dataset
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation import metrics
from roadtorch.evaluation.methods import Contender, collect_contenders
from roadtorch.evaluation.result import Failure
from roadtorch.evaluation.scoring import run_contenders
from roadtorch.evaluation.tally import Tally
from tests.evaluation.conftest import GROUPS, answering, scores_of, tally_of


def look(image, item) -> Detection:
    return Detection(image.mean(0), image.mean(0) > 0.5, {"layout": image})


def test_one_image_more_costs_little_memory(dataset):
    tally = tally_of(dataset, look)

    assert (
        len(tally.rows) / len(dataset.items) < 2500
    )  # bytes: 256 levels of road and of background, 4 each


def test_images_with_and_without_layout_may_be_mixed_in_any_order(dataset):
    item, tally = dataset.items[0], Tally()
    _, values = next(run_contenders(dataset, [Contender("it", lambda _: look)]))
    assert not isinstance(values, Failure)
    without = replace(values["it"], layout=None)
    for name, counts in {"a": without, "b": values["it"], "c": without}.items():
        tally.add(replace(item, name=name), counts)

    table = tally.table()

    assert list(table.names) == ["a", "b", "c"]
    assert (table.road.road == tally_of(dataset, look).table().road.road[0]).all()
    assert table.layout is not None
    assert (table.layout.flatten(1).sum(1) > 0).tolist() == [False, True, False]


def test_images_come_group_by_group_when_groups_are_asked_for(dataset):
    tally = tally_of(dataset, look)

    table = tally.table(GROUPS[2:0:-1])

    assert list(table.groups) == [GROUPS[2]] * 2 + [GROUPS[1]] * 2
    assert torch.equal(table.road.road, tally.table(names=table.names).road.road[[2, 3, 0, 1]])
    assert tally.table(GROUPS[2:]).names == table.names[:2]


def test_counts_go_between_processes_whole_and_small() -> None:
    generator = torch.Generator().manual_seed(0)
    road = torch.rand(60, 80, generator=generator) > 0.5
    likelihood = torch.rand(60, 80, generator=generator)
    counts = metrics.count_levels(likelihood, road, torch.ones_like(road))

    message = pickle.dumps(counts)
    restored = pickle.loads(message)

    assert torch.equal(restored.road, counts.road)
    assert torch.equal(restored.background, counts.background)
    assert restored.road.dtype == torch.int64
    assert len(message) < 20 * 4800 < counts.road.numel() * 8


# --- scoring ----------------------------------------------------------------------------


def test_a_detector_that_breaks_is_named(dataset):
    def look(image, item):
        raise ZeroDivisionError("no road")

    item, result = next(run_contenders(dataset, [Contender("mine", lambda _: look)]))

    assert result == Failure(item.name, item.group, "mine: ZeroDivisionError: no road")


def test_two_processes_give_the_results_of_one_in_order(dataset):
    methods, chosen = collect_contenders(dataset, (), {}), subsample_dataset(dataset, 3)

    serial, parallel = (list(run_contenders(chosen, methods, jobs=jobs)) for jobs in (1, 2))

    assert [item for item, _ in serial] == [dataset.items[i] for i in (0, 2, 4)]
    for (item, first), (item_again, second) in zip(serial, parallel, strict=True):
        assert item == item_again
        assert not isinstance(first, Failure)
        assert not isinstance(second, Failure)
        assert first.keys() == second.keys() == {method.name for method in methods}
        for name, counts in first.items():
            assert torch.equal(counts.road.road, second[name].road.road)
            assert torch.equal(counts.road.background, second[name].road.background)


# --- views ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LowerHalf:
    """A view of the lower half of an image, twice as large."""

    name: ClassVar[str] = "the lower half"

    def __call__(self, item: LabelledItem, values: torch.Tensor) -> torch.Tensor:
        lower = values[..., values.shape[-2] // 2 :, :]
        return lower.repeat_interleave(2, -1).repeat_interleave(2, -2)


def test_maps_and_truth_are_scored_in_the_view_of_the_set(dataset, scenes):
    viewed = replace(dataset, scoring_space=LowerHalf())

    def above(name):  # wrong in the upper half alone
        likelihood = scenes[name].road.clone()
        likelihood[:24] = ~likelihood[:24]
        return likelihood

    plain, in_view = (
        scores_of(tally_of(view, answering(above))).headline for view in (dataset, viewed)
    )

    assert plain["maxf"] < 0.9
    assert in_view["maxf"] == pytest.approx(1)
    first = dataset.items[0].name
    whole = scenes[first]
    seen_counts = tally_of(replace(viewed, items=dataset.items[:1]), answering(above)).road[
        "0001TP"
    ]
    assert int(seen_counts.road.sum()) == 4 * int((whole.road & ~whole.void)[24:].sum())


def test_likelihoods_are_rounded_to_the_levels_of_the_set(dataset):
    pale = answering(lambda name: torch.full((48, 64), 0.4))
    two = replace(dataset, levels=2)

    tally = tally_of(two, pale)

    assert tally.road["0001TP"].levels == 2
    assert scores_of(tally).best_threshold == 0
