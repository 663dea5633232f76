"""What corrected pictures buy: learning curves simulated with true labels, by rule and draw.

    python train/study_corrections.py run ../shared/data --out out/corrections --budget 8
    python train/study_corrections.py table --out out/corrections

A curve has a pool, from which pictures are corrected, and a test part that training never sees.
"Corrected" is what "right as it is" leaves behind: road, not road and void of every pixel, no
layout. The rest of the pool has machine labels. IDD: 150 pictures of the pool and 100 others. A
CamVid drive: the pool is its first part, the test begins 60 s after it (0001TP lasts 61 s in all,
so it was for choosing settings and is not reported). A folder of many/: every second picture; they
are no recordings. A line a run is appended to OUT/runs.jsonl, and what is there is not run again;
``--budget`` starts no run after so many minutes. CNN-7: ``--config configs/corrections-cnn7.toml
--label cnn-7``; its "road head" is the detector itself.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
import torch
from torch import Tensor

from roadtorch.annotate.next_pictures import RULES, Candidates, picture_features
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.corrections import Correction
from roadtorch.data.dataset import Dataset, Item
from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.fusion import RoadCalibration
from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.scoring import read_scene
from roadtorch.layout.weights import shipped_weights
from roadtorch.settings import merge, parse_assignments, read_settings_file
from roadtorch.train.config import Training, build_training
from roadtorch.train.run import FUSION, Request, train

CONFIG = Path(__file__).parents[1] / "configs" / "corrections.toml"
DETECTORS = {"pictures": ("fusion", "layout"), "patches": ("layout:cnn-7", "cnn-7")}
"""The detector that is scored, and the weights of no correction, by the kind of training."""
COUNTS, DRAWS = (5, 10, 20, 50), 5
GAP = 60.0  # seconds between the last picture that may be corrected and the first of the test
RATE = 30.0  # CamVid's frames a second
MANY = ("dn_cityscapes", "dn_makassar", "ycor")
LEVELS = 1024
REPLICATES = 2000


@dataclass(frozen=True)
class Curve:
    """One learning curve: what may be corrected, and what is scored."""

    name: str
    dataset: Dataset
    pool: Sequence[Item]
    test: Sequence[Item]


# --- what there is ----------------------------------------------------------------------


def curves(data: Path) -> Iterator[Curve]:
    """All curves, those that are reported first."""
    idd = open_dataset("idd-lite", data / "idd_lite")
    parts = [[item for i, item in enumerate(idd.items) if (i % 5 < 3) == here] for here in (1, 0)]
    yield Curve("idd", idd, *parts)
    camvid = open_dataset("camvid", data / "camvid", "train")
    for drive, gap in (("0016E5", GAP), ("0006R0", GAP)):
        yield drive_curve(camvid, drive, gap)
    many = open_dataset("folder", data / "many")
    for folder in MANY:
        yield folder_curve(many, folder)
    yield drive_curve(camvid, "0001TP", 10.0)
    for folder in ("dn_bdd_drivable", "cityscapes"):
        yield folder_curve(many, folder)


def drive_curve(camvid: Dataset, drive: str, gap: float) -> Curve:
    """A drive in two: as long a pool as test part, with a gap of so many seconds between them."""
    items = sorted((item for item in camvid.items if item.group == drive), key=seconds_of)
    first, last = seconds_of(items[0]), seconds_of(items[-1])
    length = (last - first - gap) / 2
    pool = [item for item in items if seconds_of(item) <= first + length]
    return Curve(drive, camvid, pool, [item for item in items if seconds_of(item) > last - length])


def seconds_of(item: Item) -> float:
    """When a CamVid frame was taken, by the number in its name."""
    return int(item.name.rpartition("_")[2].lstrip("f")) / RATE


def folder_curve(many: Dataset, folder: str) -> Curve:
    """A folder of many/: every second picture is the pool."""
    items = [item for item in many.items if item.group == folder]
    return Curve(folder, many, items[::2], items[1::2])


def corrected(dataset: Dataset, item: Item) -> Correction:
    """What a person would leave behind who said it all: the truth of the road."""
    truth = dataset.truth(item)
    labels = np.where(truth.valid, np.where(truth.road, 1, 2), 3).astype(np.uint8)
    return Correction(item.image, item.image.name, labels, True, ("truth",), 0.0, 0)


# --- one run ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Study:
    """Where runs are kept, with which settings they train, and what they are called."""

    out: Path
    config: Path
    assignments: Sequence[str]
    label: str

    @property
    def file(self) -> Path:
        """One line of JSON a run."""
        return self.out / "runs.jsonl"

    def done(self) -> list[dict[str, Any]]:
        """The runs that were made."""
        return (
            list(map(json.loads, self.file.read_text().splitlines())) if self.file.exists() else []
        )

    def run(self, curve: Curve, rule: str, count: int, draw: int) -> None:
        """Correct so many pictures of the pool, train, score, and append a line."""
        start = time.monotonic()
        key = {"curve": curve.name, "label": self.label, "rule": rule, "n": count, "draw": draw}
        places = RULES[rule](self.candidates(curve), [], count, draw) if count else []
        people = [corrected(curve.dataset, curve.pool[place]) for place in places]
        values = merge(read_settings_file(self.config), parse_assignments(self.assignments))
        training = build_training(merge(values, {"random_seed": draw}))
        detector, shipped = DETECTORS[training.name]
        weights, centre = shipped_weights(shipped), RoadCalibration().centre
        if people:
            weights = self._trained(curve, people, training)
        own: dict[str, Any] = {"weights": {"file": str(weights)}}
        found = moved = score(load_detector(detector, **own), curve)
        if people and training.name == "pictures":
            centre = read_settings_file(weights.with_name(FUSION))["calibration"]["centre"]
            moved = score(load_detector(detector, **own, calibration={"centre": centre}), curve)
        line = {**key, "centre": centre, **found, "f_centre": moved["f"]}
        line |= {"counts_centre": moved["counts"], "corrected": [one.name for one in people]}
        line["seconds"] = round(time.monotonic() - start, 1)
        with self.file.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(*key.values(), *(f"{name} {line[name]:.4f}" for name in SHOWN), flush=True)

    def _trained(self, curve: Curve, people: Sequence[Correction], training: Training) -> Path:
        pictures, out = self._pictures(curve), self.out / "run"
        if out.exists():
            rmtree(out)  # of the last run of this script; its line is kept
        request = Request(str(pictures), out, False, self._prepared(curve, training), True)
        outcome = train(training, Request(**{**vars(request), "corrections": people}))
        if outcome.weights is None:
            raise KeyboardInterrupt
        return outcome.weights

    def _prepared(self, curve: Curve, training: Training) -> Path:
        return self.out / curve.name / f"prepared-{training.name}"

    def _pictures(self, curve: Curve) -> Path:
        """A folder with links to the pool."""
        folder = self.out / curve.name / "pool"
        folder.mkdir(parents=True, exist_ok=True)
        for item in curve.pool:
            link = folder / item.image.name
            if not link.is_symlink():
                link.symlink_to(item.image.resolve())
        return folder

    def candidates(self, curve: Curve) -> Candidates:
        """Trust and features of the pool, by ``fusion`` as it is shipped; kept on disk."""
        path = self.out / curve.name / "candidates.npz"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            detector, seen = load_detector("fusion"), []
            for item in curve.pool:
                image = curve.dataset.read(item)[0]
                detection = detector.detect(image)
                maps = torch.cat([detection.cues["layout"], detection.likelihood[None]])
                seen.append((detection.trust or np.nan, picture_features(image, maps)))
            trusts, features = zip(*seen, strict=True)
            np.savez(path, trust=np.array(trusts), features=torch.stack(features).numpy())
        with np.load(path) as known:
            return Candidates(*(torch.from_numpy(known[name]) for name in ("trust", "features")))


SHOWN = ("maxf", "f", "f_centre", "head", "centre")


def score(detector: Detector, curve: Curve) -> dict[str, Any]:
    """MaxF, F of the masks and MaxF of the network's road alone; the masks' counts by picture."""
    maps, head, counts = [], [], []
    for item in curve.test:
        scene = read_scene(curve.dataset, item)
        truth, found = scene.truth, detector.detect(scene.image)
        learned = found.cues.get("learned_road", found.likelihood)
        for kept, likelihood in ((maps, found.likelihood), (head, learned)):
            kept.append(metrics.count_levels(likelihood, truth.road, truth.valid, LEVELS))
        counts.append(metrics.count_mask(found.mask, truth.road, truth.valid))
    rows = [[int(n) for n in (c.true_positive, c.false_positive, c.false_negative)] for c in counts]
    f = pooled_f(torch.tensor(rows, dtype=torch.float64)[None])
    return {"maxf": best(maps), "head": best(head), "f": float(f), "counts": rows}


def best(counts: Sequence[RoadCounts]) -> float:
    """MaxF of all pictures together."""
    total = RoadCounts(sum(c.road for c in counts), sum(c.other for c in counts))  # type: ignore[arg-type]
    return float(metrics.max_f(total)[0])


def pooled_f(counts: Tensor) -> Tensor:
    """F (b,) of pictures' true and false positives and false negatives (b,n,3) together."""
    hit, false, missed = counts.sum(1).unbind(-1)
    return metrics.f_measure(Decisions(hit, false, missed, torch.zeros_like(hit)))


# --- tables -----------------------------------------------------------------------------


def table(runs: Sequence[dict[str, Any]]) -> str:
    """A row for every curve, rule and number: means over draws and intervals of the gains in F.

    The intervals (95 %) draw draws and test pictures anew, the same pictures before and after.
    """
    base = {(one["curve"], one["label"]): one for one in runs if one["n"] == 0}
    cells: dict[tuple[str, str, str, int], list[dict[str, Any]]] = defaultdict(list)
    for one in runs:
        cells[one["curve"], one["label"], one["rule"], one["n"]].append(one)
    lines = ["| pictures | rule | n | draws | MaxF | road head | F | F, centre refitted | gain |"]
    lines.append("|---|---|---|---|---|---|---|---|---|")
    for (curve, label, rule, count), own in cells.items():
        means = [np.mean([one[name] for one in own]) for name in ("maxf", "head", "f", "f_centre")]
        known = base.get((curve, label))
        gain = told_gain(known, own) if known and count else ""
        about = " ".join(filter(None, (curve, label)))
        shown = " | ".join(f"{mean:.3f}" for mean in means)
        lines.append(
            f"| {about} | {rule if count else ''} | {count} | {len(own)} | {shown} | {gain} |"
        )
    return "\n".join(lines)


def told_gain(before: dict[str, Any], after: Sequence[dict[str, Any]]) -> str:
    """Gain in F with the refitted centre over the shipped weights, with its interval."""
    generator = torch.Generator().manual_seed(0)
    old = torch.tensor(before["counts"], dtype=torch.float64)
    new = torch.tensor([one["counts_centre"] for one in after], dtype=torch.float64)
    drawn = torch.randint(len(old), (REPLICATES, len(old)), generator=generator)
    which = torch.randint(len(new), (REPLICATES, len(new)), generator=generator)
    f = torch.stack([pooled_f(run[drawn]) for run in new], 1)
    gains = f.gather(1, which).mean(1) - pooled_f(old[drawn])
    low, high = gains.quantile(torch.tensor([0.025, 0.975], dtype=torch.float64)).tolist()
    value = np.mean([one["f_centre"] for one in after]) - before["f"]
    return f"{value:+.3f} ({low:+.3f} to {high:+.3f})"


def main() -> None:
    parser = argparse.ArgumentParser(description="What do corrected pictures buy?")
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("data", type=Path, nargs="?", help="holds idd_lite/, camvid/ and many/")
    parser.add_argument("--out", type=Path, default=Path("out/corrections"))
    parser.add_argument("--curves", nargs="+", help="all that are reported if not given")
    parser.add_argument("--rules", nargs="+", default=list(RULES), choices=list(RULES))
    parser.add_argument("--counts", nargs="+", type=int, default=COUNTS)
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--budget", type=float, default=1e9, help="minutes")
    parser.add_argument("--config", type=Path, default=CONFIG, help="of training")
    parser.add_argument("--set", dest="assignments", nargs="+", default=[], help="of training")
    parser.add_argument("--label", default="", help="name of the settings, where they are tried")
    given = parser.parse_args()
    study = Study(given.out, given.config, given.assignments, given.label)
    if given.what == "table":
        print(table(study.done()))
        return
    torch.set_num_threads(1)
    run_all(study, given)


def run_all(study: Study, given: argparse.Namespace) -> None:
    """Every run that is asked for and not there yet, all draws of few pictures first."""
    study.out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60 * given.budget
    keys = ("curve", "label", "rule", "n", "draw")
    for curve in curves(given.data):
        if curve.name not in (given.curves or ("idd", "0016E5", "0006R0", *MANY)):
            continue
        wanted = [("random", 0, 0)]
        wanted += [(r, n, d) for d in range(given.draws) for n in given.counts for r in given.rules]
        for rule, count, draw in wanted:
            done = {tuple(one[key] for key in keys) for one in study.done()}
            # Without chance in a rule every draw corrects the same pictures; training differs.
            if (curve.name, study.label, rule, count, draw) in done or count > len(curve.pool):
                continue
            if time.monotonic() > end:
                return
            study.run(curve, rule, count, draw)


if __name__ == "__main__":
    main()
