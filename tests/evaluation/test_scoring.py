"""The pass over the pictures: order, failures, processes, views."""

from dataclasses import dataclass, replace
from typing import ClassVar

import pytest
import torch

from roadtorch.data.dataset import LabelledItem, every_kth
from roadtorch.evaluation.methods import Contender, contenders, named_detector
from roadtorch.evaluation.scoring import score
from tests.evaluation.conftest import counted, looking, summarised


def test_results_keep_the_order_of_the_set_and_every_kth_spreads(dataset):
    chosen = every_kth(dataset, 3)

    names = [result.item.name for result in score(chosen, [named_detector("prior:rows", {})])]

    assert names == [dataset.items[i].name for i in (0, 2, 4)]


def test_a_detector_that_breaks_is_named(dataset):
    def look(image, item):
        raise ZeroDivisionError("no road")

    result = next(score(dataset, [Contender("mine", lambda _: look)]))

    assert result.failure == "mine: ZeroDivisionError: no road"


def test_two_processes_give_the_results_of_one(dataset):
    methods = contenders(dataset, (), {})  # the baselines

    one, two = list(score(dataset, methods)), list(score(dataset, methods, jobs=2))

    assert [result.item for result in one] == [result.item for result in two]
    for first, second in zip(one, two, strict=True):
        assert first.scores.keys() == second.scores.keys() == {one.name for one in methods}
        for name, found in first.scores.items():
            assert torch.equal(found.road.road, second.scores[name].road.road)
            assert torch.equal(found.road.other, second.scores[name].road.other)


# --- views ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LowerHalf:
    """A view that sees the lower half of a picture, twice as large."""

    name: ClassVar[str] = "the lower half"

    def __call__(self, item: LabelledItem, values: torch.Tensor) -> torch.Tensor:
        lower = values[..., values.shape[-2] // 2 :, :]
        return lower.repeat_interleave(2, -1).repeat_interleave(2, -2)


def test_maps_and_truth_are_scored_in_the_view_of_the_set(dataset, scenes):
    viewed = replace(dataset, view=LowerHalf())

    def above(name):  # wrong in the upper half alone
        likelihood = scenes[name].road.clone()
        likelihood[:24] = ~likelihood[:24]
        return likelihood

    plain, seen = (summarised(counted(one, looking(above))).headline for one in (dataset, viewed))

    assert plain["maxf"] < 0.9
    assert seen["maxf"] == pytest.approx(1)
    first = dataset.items[0].name
    whole = scenes[first]
    seen_counts = counted(replace(viewed, items=dataset.items[:1]), looking(above)).road["0001TP"]
    assert int(seen_counts.road.sum()) == 4 * int((whole.road & ~whole.void)[24:].sum())


def test_the_levels_of_the_set_are_those_that_are_told_apart(dataset):
    pale = looking(lambda name: torch.full((48, 64), 0.4))
    two = replace(dataset, levels=2)

    found = counted(two, pale)

    assert found.road["0001TP"].levels == 2
    assert summarised(found).best_threshold == 0
