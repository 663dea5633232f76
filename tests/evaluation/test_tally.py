"""What is kept of a pass stays small, and in order."""

import pickle
from dataclasses import replace

import torch

from roadtorch.detectors.detector import Detection
from roadtorch.evaluation import metrics
from roadtorch.evaluation.methods import Contender
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.tally import Tally
from tests.evaluation.conftest import GROUPS, counted


def look(image, item) -> Detection:
    return Detection(image.mean(0), image.mean(0) > 0.5, {"layout": image})


def test_one_picture_more_costs_little_memory(dataset):
    tally = counted(dataset, look)
    size = sum(tensor[0].nbytes for tensor in tally.columns.values())

    assert size < 2500  # bytes: 256 levels of road and of background, 4 each


def test_pictures_with_and_without_layout_may_be_mixed_in_any_order(dataset):
    item, tally = dataset.items[0], Tally()
    shown = next(score(dataset, [Contender("it", lambda _: look)])).scores["it"]
    assert shown.layout is not None
    for index in range(200):  # more than there is room for at first, before and after
        is_shown = 90 <= index < 100
        counts = shown if is_shown else replace(shown, layout=None)
        tally.add(replace(item, name=f"{index}"), counts)

    kept = tally.kept()
    layout = kept.layout

    assert list(kept.names) == [f"{index}" for index in range(200)]
    assert (kept.road.road == counted(dataset, look).kept().road.road[0]).all()
    assert layout is not None
    assert len(layout) == 200
    assert torch.equal(layout.flatten(1).sum(1) > 0, (torch.arange(200) // 10) == 9)


def test_pictures_come_group_by_group_when_groups_are_asked_for(dataset):
    tally = counted(dataset, look)

    found = tally.kept(GROUPS[2:0:-1])

    assert list(found.groups) == [GROUPS[2]] * 2 + [GROUPS[1]] * 2
    assert torch.equal(found.road.road, tally.named(found.names).road.road[[2, 3, 0, 1]])
    assert tally.kept(GROUPS[2:]).names == found.names[:2]


def test_counts_go_between_processes_whole_and_small() -> None:
    generator = torch.Generator().manual_seed(0)
    road = torch.rand(60, 80, generator=generator) > 0.5
    likelihood = torch.rand(60, 80, generator=generator)
    counts = metrics.count_levels(likelihood, road, torch.ones_like(road))

    message = pickle.dumps(counts)
    found = pickle.loads(message)

    assert torch.equal(found.road, counts.road)
    assert torch.equal(found.other, counts.other)
    assert found.road.dtype == torch.int64
    assert len(message) < 20 * 4800 < counts.road.numel() * 8
