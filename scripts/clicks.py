"""How many clicks a picture takes, with and without inference after each click.

    python scripts/clicks.py ../shared/data/idd_lite --set idd-lite --limit 40
    python scripts/clicks.py ../shared/data/camvid --set camvid --group 0001TP --limit 10 \\
        --propagation color=0.05 --propagation alike=4

A simulated person clicks the superpixel with the largest error until the mask has F ≥ .98, and
gives up when no click is of use, or after 1500 clicks. A click says of the whole superpixel what most of
its pixels are. Both ways end at the same best mask: every superpixel said.
"""

import argparse
import json
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

import sys

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from roadtorch.annotate.machine import AnnotationSettings, View, look_at_picture
from roadtorch.annotate.propagation import propagated
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Truth, every_kth
from roadtorch.detectors.catalogue import load_detector
from roadtorch.segment_statistics import segment_sum
from roadtorch.settings import build_settings, parse_assignments
from roadtorch.working_size import at_picture_size

ENOUGH = 0.98
MOST = 1500


@dataclass(frozen=True)
class Course:
    """clicks: how many; reached: whether F was enough; slowest: seconds of one inference."""

    clicks: int
    reached: bool
    start: float
    end: float
    slowest: float


@dataclass(frozen=True, eq=False)
class Task:
    """A picture and its truth, bool (h,w), at the page's working size."""

    view: View
    road: torch.Tensor
    valid: torch.Tensor

    @property
    def count(self) -> int:
        return len(self.view.segment_odds)

    def by_segment(self, values: torch.Tensor) -> torch.Tensor:
        return segment_sum(values[None].float(), self.view.labels, self.count)[0]

    def f(self, mask: torch.Tensor) -> float:
        hit = float((mask & self.road & self.valid).sum())
        wrong = float(((mask != self.road) & self.valid).sum())
        return 2 * hit / max(2 * hit + wrong, 1)


def task_of(view: View, truth: Truth) -> Task:
    shape = (view.labels.shape[0], view.labels.shape[1])
    return Task(view, at_picture_size(truth.road, shape), at_picture_size(truth.valid, shape))


def correct(task: Task, settings: AnnotationSettings, infer: bool) -> Course:
    """Click until F is enough, no click is of use, or there were too many."""
    view, said = task.view, torch.zeros(task.count)
    yes = task.by_segment(task.road & task.valid)
    no = task.by_segment(~task.road & task.valid)
    verdict = torch.where(yes > no, 1.0, -1.0)
    least = torch.minimum(yes, no)  # errors that stay in a superpixel however it is said
    mask, slowest, clicks = view.odds >= 0, 0.0, 0
    start = f = task.f(mask)
    while f < ENOUGH and clicks < MOST:
        wrong = task.by_segment((mask != task.road) & task.valid)
        gain = torch.where(said == 0, wrong - least, 0)
        target = int(gain.argmax())
        if gain[target] <= 0:
            break
        said[target] = verdict[target]
        clicks += 1
        begun = time.perf_counter()
        odds = view.odds
        if infer:
            odds = odds + propagated(view.segment_odds, said, view.graph, settings.propagation)[
                view.labels
            ]
        spoken = said[view.labels]
        mask = torch.where(spoken != 0, spoken > 0, odds >= 0)
        slowest = max(slowest, time.perf_counter() - begun)
        f = task.f(mask)
    return Course(clicks, f >= ENOUGH, start, f, slowest)


def chosen_pictures(arguments: argparse.Namespace) -> Dataset:
    dataset = open_dataset(arguments.set, arguments.root, arguments.split)
    if arguments.group:
        items = tuple(item for item in dataset.items if item.group in arguments.group)
        dataset = replace(dataset, items=items)
    return every_kth(dataset, arguments.limit)


def told(name: str, courses: Sequence[Course]) -> str:
    clicks = [one.clicks for one in courses]
    quartiles = np.percentile(clicks, [25, 75])
    return (
        f"{name:<18} median {statistics.median(clicks):>5g} clicks "
        f"(quartiles {quartiles[0]:g}, {quartiles[1]:g}; mean {statistics.mean(clicks):.1f}), "
        f"F {statistics.mean(c.start for c in courses):.3f} → "
        f"{statistics.mean(c.end for c in courses):.3f}, "
        f"reached in {sum(c.reached for c in courses)} of {len(courses)}, "
        f"slowest inference {1000 * max(c.slowest for c in courses):.0f} ms"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("root", type=Path)
    parser.add_argument("--set", default="idd-lite", help="kind of data set")
    parser.add_argument("--split")
    parser.add_argument("--group", action="append", help="drives to use")
    parser.add_argument("--limit", type=int, default=20)
    parser.add_argument("--propagation", action="append", default=[], help="key=value")
    parser.add_argument("--out", type=Path, help="JSON with every picture's course")
    arguments = parser.parse_args()
    values = {"propagation": parse_assignments(arguments.propagation)}
    settings = build_settings(AnnotationSettings, values)
    detector = load_detector("fusion")
    dataset = chosen_pictures(arguments)
    rows = []
    for item in dataset.items:
        image, truth = dataset.read(item)
        task = task_of(look_at_picture(image, detector, settings), truth)
        with torch.no_grad():
            rows.append((item.name, correct(task, settings, False), correct(task, settings, True)))
    without, with_inference = [row[1] for row in rows], [row[2] for row in rows]
    print(f"{dataset.name} {' '.join(arguments.group or [])}: {len(rows)} pictures")
    print(told("each by hand", without))
    print(told("inference", with_inference))
    both = [(a.clicks, b.clicks) for _, a, b in rows if a.reached and b.reached and a.clicks]
    ratio = statistics.median(a for a, _ in both) / max(statistics.median(b for _, b in both), 1)
    print(f"{len(both)} pictures that needed clicks and reached .98 both ways: median ratio {ratio:.2f}")
    if arguments.out:
        found = [{"name": name, "hand": vars(a), "inference": vars(b)} for name, a, b in rows]
        arguments.out.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
