"""Does one more member make a detector better? Any detectors, on CamVid and IDD Lite.

    python train/study_members.py ../shared/data ufl --cache members
    python train/study_members.py ../shared/data oneclass:gaussian:O1O2 ufl --base fusion

The likelihoods B of the base and M of a member are joined as odds, as in naive Bayes (P2, eq. 4):
logit(B) + w logit(M). The weight w, and among several members the one, are chosen by mean MaxF on
two drives of CamVid and told on the third; on IDD Lite what all three choose. Differences from
the base stand with 95 % intervals over pictures drawn anew. Maps are looked at in every third row
and column, and kept in the cache, by set and detector, so that a detector runs once: remove its
folder when the detector has changed.
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Item, Truth, every_kth
from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import boundary, comparison, metrics
from roadtorch.evaluation.contenders import named_detector
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.summary import summarise
from roadtorch.evaluation.tally import Score, Tally
from roadtorch.evaluation.thresholds import shared_threshold
from roadtorch.io.image import read_image, write_npy
from roadtorch.road.fusion import fused_log_odds
from roadtorch.runtime.image_cache import image_cache

STEP = slice(1, None, 3)
WEIGHTS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0)
SHOWN = ("maxf", "auc_pooled", "auc_mean", "ap", "iou", "brier")


@dataclass(frozen=True)
class Picture:
    """A labelled picture: where road is, and the likelihood (h,w) of every detector by name."""

    item: Item
    truth: Truth
    maps: Mapping[str, Tensor]


# --- what the detectors say, once ---------------------------------------------------------


def read_pictures(dataset: Dataset, names: list[str], cache: Path) -> list[Picture]:
    """All pictures of a set with the maps of the detectors, from the cache where they are."""
    detectors = {name: load_detector(name) for name in names}
    return [
        Picture(item, reduced_truth(dataset.truth(item)), picture_maps(item, detectors, cache))
        for item in tqdm(dataset.items, dataset.name, disable=None)
    ]


def reduced_truth(truth: Truth) -> Truth:
    """The truth in the rows and columns that are looked at."""
    return Truth(truth.road[STEP, STEP], truth.valid[STEP, STEP])


def picture_maps(item: Item, detectors: Mapping[str, Detector], cache: Path) -> dict[str, Tensor]:
    """The likelihoods of one picture by detector; those not in the cache are made."""
    paths = {name: cache / name.replace(":", "_") / f"{item.image.stem}.npy" for name in detectors}
    missing = [name for name, path in paths.items() if not path.exists()]
    if missing:
        image = read_image(item.image)
        with image_cache():
            for name in missing:
                paths[name].parent.mkdir(parents=True, exist_ok=True)
                write_npy(paths[name], detectors[name].detect(image).likelihood[STEP, STEP])
    return {name: torch.from_numpy(np.load(path)) for name, path in paths.items()}


# --- joined ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Joined:
    """A base, a member beside it, by name, and the weight of the member's log odds."""

    base: str
    member: str
    weight: float

    def likelihood(self, picture: Picture) -> Tensor:
        """p(road | both) (h,w)."""
        maps = [picture.maps[self.base], picture.maps[self.member]]
        return fused_log_odds(maps, [1.0, self.weight]).sigmoid()


def count(picture: Picture, likelihood: Tensor) -> RoadCounts:
    """Pixels of one picture by likelihood."""
    return metrics.count_levels(likelihood, picture.truth.road, picture.truth.valid)


Choices = Mapping[Joined, Mapping[str, RoadCounts]]
"""The counts of each drive, by what is joined how."""


def drive_counts(pictures: list[Picture], base: str, member: str) -> Choices:
    """For every weight of a member the counts of each drive."""
    found: dict[Joined, dict[str, RoadCounts]] = {
        Joined(base, member, weight): {} for weight in WEIGHTS
    }
    for picture in pictures:
        drive = picture.item.group or ""
        for joined, sums in found.items():
            more = count(picture, joined.likelihood(picture))
            sums[drive] = sums[drive] + more if drive in sums else more
    return found


def best_choice(counts: Choices, drives: list[str]) -> Joined:
    """The choice with the highest mean MaxF over the drives, the first of equals."""
    return max(counts, key=lambda joined: mean_max_f(counts[joined], drives))


def held_out_choices(counts: Choices, drives: list[str]) -> dict[str, Joined]:
    """For every drive what the others choose."""
    return {
        drive: best_choice(counts, [other for other in drives if other != drive])
        for drive in drives
    }


def mean_max_f(counts: Mapping[str, RoadCounts], drives: list[str]) -> float:
    """Mean MaxF over the drives."""
    return float(np.mean([float(metrics.max_f(counts[drive])[0]) for drive in drives]))


def tally(pictures: list[Picture], look: Callable[[Picture], Tensor]) -> Tally:
    """The evaluator's counts of maps that are made from each picture's; masks do not count."""
    found = Tally()
    for picture in pictures:
        truth, likelihood = picture.truth, look(picture)
        mask = likelihood >= 0.5
        score = Score(
            count(picture, likelihood),
            metrics.count_mask(mask, truth.road, truth.valid),
            boundary.count_boundary(mask, truth.road, truth.valid),
            layout=None,
            labels=None,
            seconds=0.0,
        )
        found.add(picture.item, score)
    return found


# --- what is told ---------------------------------------------------------------------------


def compare(title: str, tallies: Mapping[str, Tally], thresholds: Mapping[str, float]) -> None:
    """Print the figures of the base (the first one) and of what has been joined to it.

    thresholds: chosen elsewhere, by name; without them the other drives choose.
    """
    print(f"\n{title}")
    base, resampled = next(iter(tallies)), {}
    contender = named_detector(base, {"threshold": 0.5})
    for name, each in tallies.items():
        figures = summarise(contender, each, thresholds.get(name))
        resampled[name] = comparison.resample(each, figures)
        shown = "  ".join(f"{drive['maxf']:.3f}" for drive in figures.drives.values())
        means = "  ".join(f"{key} {figures.headline[key]:.4f}" for key in SHOWN)
        print(f"{name:32s} {shown}  {means}")
    for name, changes in comparison.compare(resampled, base).differences.items():
        for key in SHOWN:
            change, (low, high) = changes[key].value, changes[key].interval
            print(f"  {name} less {base}, {key}: {change:+.4f} ({low:+.4f} to {high:+.4f})")


def study(base: str, members: list[str], camvid: list[Picture], idd: list[Picture]) -> None:
    """Choose a member and its weight, and tell what it is worth."""
    counts: dict[Joined, Mapping[str, RoadCounts]] = {}
    for member in members:
        own = drive_counts(camvid, base, member)
        print(f"\n{member} beside {base}: MaxF of each drive over the weight")
        for joined, each in own.items():
            drives = sorted(each)
            shown = "  ".join(f"{float(metrics.max_f(each[drive])[0]):.4f}" for drive in drives)
            print(f"  {joined.weight:<5g} {shown}  mean {mean_max_f(each, drives):.4f}")
        counts |= own
    drives = sorted(next(iter(counts.values())))
    held_out, everywhere = held_out_choices(counts, drives), best_choice(counts, drives)
    print("\nchosen on the other drives")
    for drive, joined in (held_out | {"all three": everywhere}).items():
        print(f"  {drive:10s} {joined.weight:g} of {joined.member}")
    title = f"{base} + {members[0] if len(members) == 1 else 'the chosen'}"
    alone = {base: lambda picture: picture.maps[base]}
    chosen = {title: lambda picture: held_out[picture.item.group or ""].likelihood(picture)}
    compare("CamVid", {name: tally(camvid, look) for name, look in (alone | chosen).items()}, {})
    thresholds = {
        base: shared_threshold(counts[Joined(base, members[0], 0.0)]),
        title: shared_threshold(counts[everywhere]),
    }
    looks = alone | {title: everywhere.likelihood}
    compare("IDD Lite", {name: tally(idd, look) for name, look in looks.items()}, thresholds)


def main() -> None:
    parser = argparse.ArgumentParser(description="Does one more member make a detector better?")
    parser.add_argument("data", type=Path, help="the folder that holds camvid/ and idd_lite/")
    parser.add_argument("members", nargs="+", help="names of detectors, one is chosen")
    parser.add_argument("--base", default="fusion")
    parser.add_argument("--cache", type=Path, default=Path("members"), help="where maps are kept")
    parser.add_argument("--limit", type=int, help="look at this many pictures of each set only")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    names = [arguments.base, *arguments.members]
    sets = {"camvid": open_dataset("camvid", arguments.data / "camvid")}
    sets["idd_lite"] = open_dataset("idd-lite", arguments.data / "idd_lite")
    camvid, idd = (
        read_pictures(every_kth(dataset, arguments.limit), names, arguments.cache / key)
        for key, dataset in sets.items()
    )
    study(arguments.base, arguments.members, camvid, idd)


if __name__ == "__main__":
    main()
