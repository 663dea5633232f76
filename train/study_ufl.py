"""Studies of the detectors ``ufl`` and ``ufl:original`` (P1) on CamVid.

    python train/study_ufl.py bases ../shared/data --out out      # P1, Fig. 6a: F over K
    python train/study_ufl.py weight ../shared/data --out out     # P1, Fig. 6b: F over lambda
    python train/study_ufl.py seeds ../shared/data                # five random starts
    python train/study_ufl.py readings ../shared/data             # where text and program differ
    python train/study_ufl.py steps ../shared/data                # from the program to ``ufl``
    python train/study_ufl.py likelihoods ../shared/data          # which map makes the best one
    python train/study_ufl.py choose ../shared/data               # settings, leave one drive out
    python train/study_ufl.py ceiling ../shared/data              # the best regions, by the labels

Development frames: every seventh of the training split of each drive. Reported beside them:
every fifth frame of the validation split, 21 frames, never chosen on. All at 160x120, labels
``[1::3, 1::3]``, as the authors' program was measured. F is that of the mask, counts pooled
inside a set of frames; the mean is over the three drives.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detector import decide
from roadtorch.detectors import ufl
from roadtorch.evaluation.metrics import (
    Decisions,
    RoadCounts,
    count_levels,
    count_mask,
    f_measure,
    max_f,
)
from roadtorch.settings import build_settings
from roadtorch.ufl import hierarchy, maps, preprocess, road
from roadtorch.ufl.learned import LearnedFeatures, learn_features
from roadtorch.ufl.road import SHARPNESS

DRIVES = ("0001TP", "0006R0", "0016E5")
REPORTED = "val, every 5th"
EVERY, FIRST = 7, 3
LEVELS = 4096
ENTRIES = {entry.name: entry for entry in ufl.ENTRIES}
BASES = (108, 200, 300, 400, 500)
WEIGHTS = (0.0, 1.0, 1.5, 2.0, 3.0, 4.0)
PROGRAM: dict[str, Any] = {}
READINGS: dict[str, dict[str, Any]] = {
    "program": PROGRAM,
    "brightness 1 (eq. 2)": {"smoothing": {"target": 1.0}},
    "K-means from patches": {"dictionary": {"start": "patches"}},
    "distances over bases (eq. 3)": {"maps": {"encoder": "patch"}},
    "rows from 1 (eq. 5)": {"maps": {"row_weights": "from_one"}},
    "mean map not over its maximum": {"maps": {"scale": "none"}},
    "no threshold at 1": {"tree": {"top": "left_out"}},
    "place from 1 (eq. 6)": {"road": {"place": "from_one"}},
    "errors scaled everywhere": {"road": {"error_range": "everywhere"}},
    "road from the best sum (listing)": {"road": {"model": "best"}},
    "whole picture never road": {"road": {"whole": "never"}},
    "no mean (eq. 10)": {"road": {"centring": "none"}},
    "mean for the basis alone (eq. 10)": {"road": {"centring": "basis"}},
    "one iteration": {"road": {"rounds": 1}},
    "three iterations": {"road": {"rounds": 3}},
    "no dilation": {"road": {"dilation": 0}},
}
STEPS: dict[str, dict[str, Any]] = {
    "program": PROGRAM,
    "isolated road dropped": {"isolated": "drop"},
    "+ single regions": {"tree": {"nodes": "regions"}},
    "+ place ahead": {"road": {"place": "ahead"}},
    "+ lambda 1.5, dilation 2": {"road": {"weight": 1.5, "dilation": 2}},
    "+ minPts 25": {"tree": {"least": 25}},
    "+ brightness 0.25 = ufl": {"smoothing": {"target": 0.25}},
}

Frames = Mapping[str, list[tuple[Tensor, Truth]]]
Scores = Mapping[str, float]


def read_frames(data: Path) -> Frames:
    """The development frames of each drive, and the reported ones."""
    train = open_dataset("camvid", data / "camvid", "train")
    val = open_dataset("camvid", data / "camvid", "val")
    frames = {
        drive: [item for item in train.items if item.group == drive][FIRST::EVERY]
        for drive in DRIVES
    }
    read = {drive: [small(*train.read(item)) for item in own] for drive, own in frames.items()}
    return {**read, REPORTED: [small(*val.read(item)) for item in val.items[::5]]}


def small(image: Tensor, truth: Truth) -> tuple[Tensor, Truth]:
    """A frame of 480x360 at the size at which the detectors work."""
    reduced = Truth(truth.road[1::3, 1::3], truth.valid[1::3, 1::3], None)
    return preprocess.bicubic(image, (reduced.road.shape[0], reduced.road.shape[1])), reduced


def settings_of(name: str, values: Mapping[str, Any]) -> ufl.OriginalUflSettings:
    """The settings of a detector, some of them changed."""
    made = build_settings(ENTRIES[name].settings, values)
    assert isinstance(made, ufl.OriginalUflSettings)
    return made


def cues_of(
    image: Tensor, variants: Mapping[str, ufl.OriginalUflSettings]
) -> Iterator[tuple[str, dict[str, Tensor]]]:
    """The cues of each variant; features that several variants share are learned once."""
    learned: dict[Any, LearnedFeatures] = {}
    for name, settings in variants.items():
        parts = (settings.smoothing, settings.dictionary, settings.maps)
        key = tuple(tuple(part.model_dump().values()) for part in parts)
        if key not in learned:
            learned[key] = learn_features(image, *parts)
        yield name, ufl.road_cues(learned[key], settings)


def score(frames: Frames, variants: Mapping[str, ufl.OriginalUflSettings]) -> dict[str, Scores]:
    """F of the masks of each variant by set of frames; prints a table."""
    found: dict[str, dict[str, Decisions]] = {name: {} for name in variants}
    for drive, own in frames.items():
        for image, truth in tqdm(own, drive, disable=None):
            for name, cues in cues_of(image, variants):
                mask = decide(cues["likelihood"], variants[name])
                add(found[name], drive, count_mask(mask, truth.road, truth.valid))
    scores = {name: scored(counts, f_measure) for name, counts in found.items()}
    for name, each in scores.items():
        show(name, each)
    return scores


def add(counts: dict[str, Any], key: str, more: Any) -> None:
    """Counts of one more frame, by set of frames."""
    counts[key] = counts[key] + more if key in counts else more


def scored(counts: Mapping[str, Any], measure: Callable[[Any], Tensor]) -> Scores:
    """A figure for every set of frames."""
    return {drive: float(measure(each)) for drive, each in counts.items()}


def show(name: str, scores: Scores) -> None:
    """One row of a table."""
    drives = "  ".join(f"{scores[drive]:.3f}" for drive in DRIVES)
    print(f"{name:36s} {drives}  mean {mean(scores):.4f}  val {scores[REPORTED]:.3f}", flush=True)


def mean(scores: Scores) -> float:
    """Over the three development drives."""
    return float(np.mean([scores[drive] for drive in DRIVES]))


# --- the studies --------------------------------------------------------------------------


def curve(frames: Frames, out: Path, key: tuple[str, str], values: tuple[Any, ...]) -> None:
    """F over one setting of both detectors, as table and plot (P1, Fig. 6)."""
    group, name = key
    variants = {
        f"{entry} {name} {value}": settings_of(entry, {group: {name: value}})
        for entry in ENTRIES
        for value in values
    }
    scores = list(score(frames, variants).values())
    curves = {
        entry: scores[number * len(values) : (number + 1) * len(values)]
        for number, entry in enumerate(ENTRIES)
    }
    draw(curves, name, values, out / f"ufl_{name}.png")


def draw(
    curves: Mapping[str, list[Scores]], name: str, values: tuple[Any, ...], path: Path
) -> None:
    """One line for each detector and set of frames."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for (entry, scores), style in zip(curves.items(), ("-", "--"), strict=True):
        axes.plot(values, [mean(each) for each in scores], "o" + style, label=f"{entry}, drives")
        val = [each[REPORTED] for each in scores]
        axes.plot(values, val, "s" + style, label=f"{entry}, {REPORTED}")
    axes.set(xlabel={"bases": "K", "weight": "λ"}[name], ylabel="F")
    axes.grid(alpha=0.3)
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    print(path)


def readings(frames: Frames, out: Path) -> None:
    """Each reading alone, everything else as in the program."""
    del out
    score(frames, {name: settings_of("ufl:original", each) for name, each in READINGS.items()})


def steps(frames: Frames, out: Path) -> None:
    """From the program to ``ufl``, one change after the other."""
    del out
    values: dict[str, Any] = {}
    variants = {}
    for name, change in STEPS.items():
        for key, value in change.items():
            merged = {**values.get(key, {}), **value} if isinstance(value, dict) else value
            values = {**values, key: merged}
        variants[name] = settings_of("ufl:original", values)
    score(frames, variants)


def seeds(frames: Frames, out: Path) -> None:
    """Both detectors from five random starts."""
    del out
    variants = {
        f"{entry}, seed {seed}": settings_of(entry, {"dictionary": {"random_seed": seed}})
        for entry in ENTRIES
        for seed in range(5)
    }
    score(frames, variants)


def candidates(cues: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Maps in [0,1] that could serve as the likelihood."""
    mask = list(cues)[-1]  # the last iteration
    road_mask = cues[mask].float()
    covered = (cues["mean_map"] > 0).float()
    pixel = torch.sigmoid(SHARPNESS * cues["pixel_stability"]) * covered
    node = cues["node_stability"] / cues["node_stability"].max().clamp_min(1e-9)
    levels = cues["tree_levels"] / 17
    return {
        "mean map": cues["mean_map"],
        "1 - reconstruction error": (1 - cues["error"]) * covered,
        "levels survived": levels,
        "levels survived, road alone": levels * road_mask,
        "stability of the node": node,
        "stability of the pixel": pixel,
        "mask": road_mask,
        "mask + mean map": (road_mask + cues["mean_map"]) / 2,
        "mask + levels": (road_mask + levels) / 2,
        "mask + stability of the pixel": (road_mask + pixel) / 2,
        "mask + 2 x stability of the pixel": (road_mask + 2 * pixel) / 3,
        "mask + 3 x stability of the pixel": (road_mask + 3 * pixel) / 4,
    }


def likelihoods(frames: Frames, out: Path) -> None:
    """MaxF of the candidates under the settings of both detectors."""
    del out
    variants = {entry: settings_of(entry, {}) for entry in ENTRIES}
    found: dict[str, dict[str, RoadCounts]] = {}
    for drive, own in frames.items():
        for image, truth in tqdm(own, drive, disable=None):
            for entry, cues in cues_of(image, variants):
                for name, likelihood in candidates(cues).items():
                    counts = count_levels(likelihood.clamp(0, 1), truth.road, truth.valid, LEVELS)
                    add(found.setdefault(f"{entry}: {name}", {}), drive, counts)
    for name, counts in found.items():
        show(name, scored(counts, lambda each: max_f(each)[0]))


def choose(frames: Frames, out: Path) -> None:
    """Weight and triangle chosen on two drives, told on the third and on the val frames."""
    del out
    places = product((1.0, 1.5, 2.0), (0.4, 0.45), (1.3, 1.6, 1.9))
    variants = {
        f"weight {weight}, apex {apex}, base {base}": settings_of(
            "ufl", {"road": {"weight": weight, "apex": apex, "base": base}}
        )
        for weight, apex, base in places
    }
    scores = score(frames, variants)
    for held_out in DRIVES:
        others = [drive for drive in DRIVES if drive != held_out]
        best = max(scores, key=lambda name: sum(scores[name][drive] for drive in others))
        told = f"{scores[best][held_out]:.4f}, val {scores[best][REPORTED]:.4f}"
        print(f"not chosen on {held_out}: {best}: {told}")


def ceiling(frames: Frames, out: Path) -> None:
    """F of the nodes and of the regions that the labels would choose."""
    del out
    found: dict[str, dict[str, Decisions]] = {}
    settings = settings_of("ufl:original", {})
    side = settings.dictionary.side
    steps = hierarchy.thresholds(settings.tree.levels, settings.tree.top)
    for drive, own in frames.items():
        for image, truth in tqdm(own, drive, disable=None):
            learned = learn_features(image, settings.smoothing, settings.dictionary, settings.maps)
            mean_map = maps.mean_map(learned.maps.maps, settings.maps.scale)
            regions = hierarchy.threshold_regions(mean_map, steps)
            for nodes in ("runs", "regions"):
                tree = hierarchy.build_tree(regions, settings.tree.least, nodes)
                mask = best_nodes(tree, truth, side)
                for reach in range(4):
                    whole = road.mask_to_image(road.widened(mask, reach), side)
                    name = f"best {nodes}, widened by {reach}"
                    counts = count_mask(whole, truth.road, truth.valid)
                    add(found.setdefault(name, {}), drive, counts)
    for name, counts in found.items():
        show(name, scored(counts, f_measure))


def best_nodes(tree: hierarchy.Tree, truth: Truth, side: int) -> Tensor:
    """The disjoint nodes whose first regions hold the most road for the least of the rest.

    A pixel of road is worth 1 less a share of 0.45, one of the rest costs that share: at the
    best F, half of F is what a pixel has to bring (0.45 for F = 0.9).
    """
    worth = (truth.road.double() - 0.45) * truth.valid
    rows, columns = tree.regions.labels.shape[1:]
    inside = worth[side // 2 :, side // 2 :][:rows, :columns]  # the middles of the patches
    sums = hierarchy.region_sums(tree.regions, inside)[tree.node]
    return hierarchy.selected_area(tree, hierarchy.select_nodes(tree, sums, "never").selected)


STUDIES: dict[str, Callable[[Frames, Path], None]] = {
    "bases": partial(curve, key=("dictionary", "bases"), values=BASES),
    "weight": partial(curve, key=("road", "weight"), values=WEIGHTS),
    "seeds": seeds,
    "readings": readings,
    "steps": steps,
    "likelihoods": likelihoods,
    "choose": choose,
    "ceiling": ceiling,
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Studies of the detectors ufl, ufl:original.")
    parser.add_argument("what", choices=STUDIES)
    parser.add_argument("data", type=Path, help="the folder that holds camvid/")
    parser.add_argument("--out", type=Path, default=Path("out"), help="where plots go")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    frames = read_frames(arguments.data)
    STUDIES[arguments.what](frames, arguments.out)


if __name__ == "__main__":
    main()
