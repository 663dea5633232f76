"""How many clicks a picture takes, with and without inference after each click.

    python scripts/clicks.py ../shared/data/idd_lite --set idd-lite --limit 40
    python scripts/clicks.py ../shared/data/camvid --set camvid --group 0001TP --limit 10 \\
        --propagation color=0.05 --propagation alike=4

A simulated person clicks the superpixel with the largest error until the mask has F ≥ .98, and
gives up when no click is of use, or after 1500 clicks. A click says of the whole superpixel what
most of its pixels are. Times are of CPU, on one thread.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from roadtorch.annotate.machine import AnnotationSettings, PictureView, look_at_picture, mended_odds
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Truth, every_kth
from roadtorch.detectors.catalogue import load_detector
from roadtorch.imaging.resize import at_picture_size
from roadtorch.settings import build_settings, parse_assignments
from roadtorch.superpixels.statistics import segment_sum

ENOUGH = 0.98
MOST = 1500


@dataclass(frozen=True)
class Course:
    """f: before the first and after each click. said: the superpixels and 1 road, -1 not.

    seconds: of CPU, of each inference.
    """

    f: tuple[float, ...]
    said: tuple[tuple[int, int], ...]
    seconds: tuple[float, ...]

    @property
    def clicks(self) -> int:
        return len(self.said)

    @property
    def reached(self) -> bool:
        return self.f[-1] >= ENOUGH


@dataclass(frozen=True, eq=False)
class Task:
    """A picture and its truth, bool (h,w), at the page's working size."""

    view: PictureView
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


def task_of(view: PictureView, truth: Truth) -> Task:
    shape = (view.labels.shape[0], view.labels.shape[1])
    return Task(view, at_picture_size(truth.road, shape), at_picture_size(truth.valid, shape))


def correct(task: Task, settings: AnnotationSettings, infer: bool) -> Course:
    """Click until F is enough, no click is of use, or there were too many."""
    said = torch.zeros(task.count)
    yes = task.by_segment(task.road & task.valid)
    no = task.by_segment(~task.road & task.valid)
    least = torch.minimum(yes, no)  # errors that stay in a superpixel however it is said
    mask, course, seconds = task.view.odds >= 0, [], []
    f = [task.f(mask)]
    while f[-1] < ENOUGH and len(course) < MOST:
        wrong = task.by_segment((mask != task.road) & task.valid)
        gain = torch.where(said == 0, wrong - least, 0)
        target = int(gain.argmax())
        if gain[target] <= 0:
            break
        said[target] = 1 if yes[target] > no[target] else -1
        course.append((target, int(said[target])))
        begun = time.thread_time()
        mask = mask_after(task.view, said, settings, infer)
        seconds.append(time.thread_time() - begun)
        f.append(task.f(mask))
    return Course(tuple(f), tuple(course), tuple(seconds))


def mask_after(
    view: PictureView, said: torch.Tensor, settings: AnnotationSettings, infer: bool
) -> torch.Tensor:
    """The mask bool (h,w) after what was said of superpixels (n,)."""
    odds = mended_odds(view, said, settings.propagation) if infer else view.odds
    spoken = said[view.labels]
    return torch.where(spoken != 0, spoken > 0, odds >= 0)


def chosen_pictures(arguments: argparse.Namespace) -> Dataset:
    dataset = open_dataset(arguments.set, arguments.root, arguments.split)
    if arguments.group:
        items = tuple(item for item in dataset.items if item.group in arguments.group)
        dataset = replace(dataset, items=items)
    if arguments.picture:
        items = tuple(item for item in dataset.items if item.name == arguments.picture)
        dataset = replace(dataset, items=items)
    return every_kth(dataset, arguments.limit)


def told(name: str, courses: Sequence[Course]) -> str:
    clicks = [one.clicks for one in courses]
    quartiles = np.percentile(clicks, [25, 75])
    return (
        f"{name:<18} median {statistics.median(clicks):>5g} clicks "
        f"(quartiles {quartiles[0]:g}, {quartiles[1]:g}; mean {statistics.mean(clicks):.1f}), "
        f"F {statistics.mean(c.f[0] for c in courses):.3f} → "
        f"{statistics.mean(c.f[-1] for c in courses):.3f}, "
        f"reached in {sum(c.reached for c in courses)} of {len(courses)}, "
        f"slowest {1000 * max(max(c.seconds, default=0) for c in courses):.0f} ms"
    )


def listed(course: Course) -> str:
    """Every click of a course on a line."""
    lines = [f"   before: F {course.f[0]:.3f}"]
    for number, ((segment, verdict), f, seconds) in enumerate(
        zip(course.said, course.f[1:], course.seconds, strict=True), start=1
    ):
        word = "road" if verdict > 0 else "not road"
        lines.append(
            f"{number:>4}  superpixel {segment:>5}  {word:<9} F {f:.3f}  {1000 * seconds:.0f} ms"
        )
    return "\n".join(lines)


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
    parser.add_argument("--picture", help="this one alone, with its clicks listed")
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
    if arguments.picture:
        print(listed(rows[0][2]))
        return
    both = [(a.clicks, b.clicks) for _, a, b in rows if a.reached and b.reached and a.clicks]
    ratio = statistics.median(a for a, _ in both) / max(statistics.median(b for _, b in both), 1)
    print(
        f"{len(both)} pictures needed clicks and reached F .98 both ways: medians "
        f"{statistics.median(a for a, _ in both):g} and {statistics.median(b for _, b in both):g} "
        f"clicks, ratio {ratio:.2f}"
    )
    if arguments.out:
        found = [{"name": name, "hand": asdict(a), "inference": asdict(b)} for name, a, b in rows]
        arguments.out.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
