"""What corrected pictures buy: learning curves simulated with true labels, by rule and draw.

    python train/study_corrections.py run ../shared/data --budget 8
    python train/study_corrections.py table
    python train/study_corrections.py figure --figure docs/corrections.svg

A curve has a pool, from which pictures are corrected, and a test part that training never sees.
"Corrected" is what "right as it is" leaves behind: road, not road and void of every pixel, no
layout. The rest of the pool has machine labels. IDD: 150 pictures of the pool and 100 others. A
CamVid drive: the pool is its first part, the test begins 60 s after it (0001TP lasts 61 s in all:
it is for choosing settings, ``choose_corrections.py``). A folder of many/: every second picture;
they are no recordings. What matters first is run first (``STAGES``). A line a run is appended to
``--runs``, with the commit and a mark of all settings that it was made with; what was made with the
same is not run again, what was made with others never stands beside it. ``--budget`` starts no run
after so many minutes. CNN-7: ``--config configs/corrections-cnn7.toml --label cnn-7``; its "road
head" is the detector itself.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from subprocess import run as run_command
from typing import Any, NamedTuple

import numpy as np
import torch

from roadtorch.annotate.next_pictures import RULES, Candidates, picture_features
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.corrections import Correction
from roadtorch.data.dataset import Dataset, Item
from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.scoring import read_scene
from roadtorch.io.atomic import digest_of, write_text
from roadtorch.layout.weights import shipped_weights
from roadtorch.settings import merge, parse_assignments, read_settings_file
from roadtorch.train.config import Training, as_values, build_training
from roadtorch.train.corrections import trust_settings
from roadtorch.train.run import FUSION, Request, train
from train.corrections_table import draw_curves, pooled_f, table

CONFIG = Path(__file__).parents[1] / "configs" / "corrections.toml"
RUNS = Path(__file__).with_name("corrections.jsonl")
DETECTORS = {"pictures": ("fusion", "layout-free"), "patches": ("layout:cnn-7", "cnn-7")}
"""The detector that is scored, and the weights of no correction, by the kind of training."""
GAP = 60.0  # seconds between the last picture that may be corrected and the first of the test
RATE = 30.0  # CamVid's frames a second
MANY = ("dn_cityscapes", "dn_makassar", "ycor")
LEVELS = 1024


class Stage(NamedTuple):
    """Runs that are made together: these curves, rules and numbers, so many draws of each."""

    curves: Sequence[str]
    rules: Sequence[str]
    counts: Sequence[int]
    draws: int


REPORTED = ("idd", "0016E5", "0006R0", *MANY)
ONE = ("random",)
STAGES = (
    Stage(REPORTED, ONE, (0,), 1),
    Stage(("idd", "0016E5", "0006R0", "ycor"), ONE, (20,), 1),
    Stage(("idd",), ONE, (5, 50, 10), 1),
    Stage(("dn_cityscapes", "dn_makassar"), ONE, (5,), 1),
    Stage(("idd",), tuple(RULES), (20,), 3),
    Stage(("0016E5",), ONE, (20, 5), 2),
    Stage(("idd",), ONE, (5, 10, 50), 3),
    Stage(("idd",), tuple(RULES), (20,), 5),
    Stage(REPORTED, tuple(RULES), (20, 5, 10, 50), 5),
)
"""What is run, in this order; what an earlier stage made is not made again."""


@dataclass(frozen=True)
class Curve:
    """One learning curve: what may be corrected, and what is scored."""

    name: str
    dataset: Dataset
    pool: Sequence[Item]
    test: Sequence[Item]


# --- what there is ----------------------------------------------------------------------


def curves(data: Path) -> Iterator[Curve]:
    """The curves that are reported."""
    idd = open_dataset("idd-lite", data / "idd_lite")
    parts = [[item for i, item in enumerate(idd.items) if (i % 5 < 3) == here] for here in (1, 0)]
    yield Curve("idd", idd, *parts)
    camvid = open_dataset("camvid", data / "camvid", "train")
    for drive, gap in (("0016E5", GAP), ("0006R0", GAP)):
        yield drive_curve(camvid, drive, gap)
    many = open_dataset("folder", data / "many")
    for folder in MANY:
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
    """Where runs are kept, and the settings they train with, which ``label`` names."""

    out: Path
    file: Path
    values: dict[str, Any]
    label: str
    commit: str = ""

    @property
    def mark(self) -> str:
        """Of all settings on which a run depends, but for its seed, and of the first weights."""
        training = build_training(self.values)
        known = [as_values(training), trust_settings(1.0), digest_of(self._shipped(training))]
        known[0].pop("random_seed")
        return sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()[:12]

    def done(self) -> list[dict[str, Any]]:
        """The runs that were made with these settings; others are left out."""
        if not self.file.exists():
            return []
        runs = map(json.loads, self.file.read_text().splitlines())
        return [one for one in runs if one.get("made_with") == self.mark]

    def run(self, curve: Curve, rule: str, count: int, draw: int) -> None:
        """Correct so many pictures of the pool, train, score, and append a line."""
        start = time.monotonic()
        key = {"curve": curve.name, "label": self.label, "rule": rule, "n": count, "draw": draw}
        places = RULES[rule](self.candidates(curve), [], count, draw) if count else []
        people = [corrected(curve.dataset, curve.pool[place]) for place in places]
        training = build_training(merge(self.values, {"random_seed": draw}))
        own: dict[str, Any] = {"weights": {"file": str(self._shipped(training))}}
        if people:
            own = self.trained(curve, people, training)
        line = {**key, **score(load_detector(DETECTORS[training.name][0], **own), curve)}
        line |= {"corrected": [one.name for one in people], "made_with": self.mark}
        line |= {"commit": self.commit, "seconds": round(time.monotonic() - start, 1)}
        with self.file.open("a") as file:
            file.write(json.dumps(line) + "\n")
        told = (f"{name} {line[name]:.4f}" for name in ("maxf", "f", "head"))
        print(*key.values(), *told, line["seconds"], flush=True)

    def _shipped(self, training: Training) -> Path:
        return shipped_weights(DETECTORS[training.name][1])

    def trained(
        self, curve: Curve, people: Sequence[Correction], training: Training
    ) -> dict[str, Any]:
        """Settings of the detector that a training leaves behind."""
        pictures, out = self._pictures(curve), self.out / "run"
        if out.exists():
            rmtree(out)  # of the last run of this script; its line is kept
        prepared = self.out / curve.name / f"prepared-{training.name}"
        outcome = train(training, Request(str(pictures), out, False, prepared, True, people))
        if outcome.weights is None:
            raise KeyboardInterrupt
        if training.name == "patches":
            return {"weights": {"file": str(outcome.weights)}}
        settings = read_settings_file(outcome.weights.with_name(FUSION))
        return {key: value for key, value in settings.items() if key != "detector"}

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


def commit() -> str:
    """The commit of the program, with a + where files differ from it."""
    here = Path(__file__).parent
    told = run_command(
        ["git", "describe", "--always", "--dirty=+", "--match", "nothing"],
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
    )
    return told.stdout.strip()


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


# --- all of them ------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description="What do corrected pictures buy?")
    parser.add_argument("what", choices=("run", "table", "figure"))
    parser.add_argument("data", type=Path, nargs="?", help="holds idd_lite/, camvid/ and many/")
    parser.add_argument("--out", type=Path, default=Path("out/corrections"), help="to work in")
    parser.add_argument("--runs", type=Path, default=RUNS, help="a line a run")
    parser.add_argument("--figure", type=Path, default=Path("docs/corrections.svg"))
    parser.add_argument("--curves", nargs="+", help="only these of the stages'")
    parser.add_argument("--rules", nargs="+", default=list(RULES), choices=list(RULES))
    parser.add_argument("--counts", nargs="+", type=int, help="only these of the stages'")
    parser.add_argument("--budget", type=float, default=1e9, help="minutes")
    parser.add_argument("--config", type=Path, default=CONFIG, help="of training")
    parser.add_argument("--set", dest="assignments", nargs="+", default=[], help="of training")
    parser.add_argument("--label", default="", help="name of the settings, where they are tried")
    given = parser.parse_args()
    values = merge(read_settings_file(given.config), parse_assignments(given.assignments))
    study = Study(given.out, given.runs, values, given.label, commit())
    if given.what == "table":
        print(table(study.done()))
    elif given.what == "figure":
        write_text(given.figure, draw_curves(study.done()))
    else:
        torch.set_num_threads(1)
        run_all(study, given)


def run_all(study: Study, given: argparse.Namespace) -> None:
    """Every run that is asked for and not there yet, by stages."""
    study.out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60 * given.budget
    known = {curve.name: curve for curve in curves(given.data)}
    keys = ("curve", "label", "rule", "n", "draw")
    done = {tuple(one[key] for key in keys) for one in study.done()}
    for name, rule, count, draw in wanted(STAGES):
        key = (name, study.label, rule, count, draw)
        asked = name in (given.curves or known) and rule in given.rules
        asked = asked and count in (given.counts or (count,))
        if not asked or key in done or count > len(known[name].pool):
            continue
        if time.monotonic() > end:
            return
        study.run(known[name], rule, count, draw)
        done.add(key)


def wanted(stages: Sequence[Stage]) -> Iterator[tuple[str, str, int, int]]:
    """Curve, rule, number and draw of the stages' runs, one draw of all before the next."""
    for stage in stages:
        for draw in range(stage.draws):
            for count in stage.counts:
                for name in stage.curves:
                    for rule in stage.rules:
                        # Without chance in a rule every draw corrects the same; training differs.
                        yield name, rule, count, draw


if __name__ == "__main__":
    main()
