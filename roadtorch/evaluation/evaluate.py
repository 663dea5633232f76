"""Score detectors on a labelled set: every picture once, then figures and comparisons.

A run that is interrupted goes on where it was: its counts so far are in one file.
"""

import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.errors import ConfigError, DatasetError, UnscorableError, unknown_name
from roadtorch.evaluation import metrics
from roadtorch.evaluation.document import earlier_thresholds
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Method, methods_for
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.result import Evaluation, Failure, held_out_thresholds, summarise
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.tally import Scored, Tally
from roadtorch.evaluation.uncertainty import best_of, compare, intervals, resample
from roadtorch.io.atomic import atomic
from roadtorch.settings import Settings

Watch = Callable[[Iterator[Scored], int, int], Iterable[Scored]]
"""Results as they come, how many pictures were done before, of how many → the same results."""


def unwatched(results: Iterator[Scored], done: int, total: int) -> Iterable[Scored]:
    """Nobody looks on."""
    return results


def evaluate(
    dataset: Dataset,
    detectors: Sequence[str] = ("fusion",),
    *,
    settings: Mapping[str, Any] | None = None,
    maps: Mapping[str, Path] | None = None,
    limit: int | None = None,
    mean_from: Dataset | None = None,
    threshold_from: Path | None = None,
    against: str | None = None,
    measures: Sequence[Measure] = MEASURES,
    jobs: int = 1,
    keep_in: Path | None = None,
    watch: Watch = unwatched,
) -> Evaluation:
    """Score detectors beside the baselines ``prior:rows``, ``prior:triangle`` and ``prior:mean``.

    detectors: names, with wildcards. settings: nested values for those that are named.
    maps: by name, folders of likelihood maps made elsewhere.
    limit: look at so many pictures only, evenly spread. mean_from: the set that teaches
    ``prior:mean`` where the groups of this one cannot. threshold_from: the metrics.json of
    an earlier run whose thresholds are taken. against: the detector that all are compared
    with, the best one if not given. measures: what is measured. jobs: processes; the figures
    do not depend on it.
    keep_in: a folder that keeps what is counted, so that an interrupted run goes on when it
    is started again; ``forget`` it when the result is safe. watch: sees the results pass,
    and may raise to interrupt.

    Raises ConfigError for what can be refused before the run, DatasetError when no picture
    could be scored, UnscorableError when no label has any road.
    """
    methods = methods_for(dataset, detectors, settings or {}, maps or {}, mean_from)
    given = earlier_thresholds(threshold_from, methods) if threshold_from else {}
    return evaluated(dataset, methods, given, limit, against, measures, jobs, keep_in, watch)


def evaluated(
    dataset: Dataset,
    methods: Sequence[Method],
    given: Mapping[str, float],
    limit: int | None = None,
    against: str | None = None,
    measures: Sequence[Measure] = MEASURES,
    jobs: int = 1,
    keep_in: Path | None = None,
    watch: Watch = unwatched,
) -> Evaluation:
    """Score methods as they are; given: thresholds of earlier runs by method.

    The rest, and what it raises, as for ``evaluate``.
    """
    names = [one.name for one in methods]
    if against is not None and against not in names:
        raise unknown_name("detector of this run", against, names)
    pictures = every_kth(dataset, limit)
    left_out, conditions = pictures.left_out, pictures.by_condition()
    tallies, failures = count_all(pictures, methods, jobs, keep_in, watch)
    figures = {
        name: summarise(one, tallies[name], given.get(name), measures, left_out, conditions)
        for name, one in zip(names, methods, strict=True)
    }
    draws = {name: resample(tallies[name], figures[name], measures) for name in names}
    return Evaluation(
        pictures,
        {name: replace(figures[name], intervals=intervals(draws[name])) for name in names},
        compare(draws, against or best_of(figures), measures),
        failures,
        tallies,
        measures,
    )


def count_all(
    dataset: Dataset, methods: Sequence[Method], jobs: int, keep_in: Path | None, watch: Watch
) -> tuple[Mapping[str, Tally], list[Failure]]:
    """Run what is left of the pass; the tallies are saved whatever ends it."""
    saved = SavedTallies(keep_in, fingerprint(dataset, methods))
    failures: list[Failure] = []
    done, total = saved.done, len(dataset.items)
    try:
        for result in watch(score(dataset, methods, jobs, done), len(done), total):
            if result.failure:
                item = result.item
                failures.append(Failure(item.name, item.group, result.failure))
            saved.add(result)
    except BaseException:
        saved.save()
        raise
    saved.sort([item.name for item in dataset.items])
    counting = {group for tally in saved.tallies.values() for _, group in tally.pictures}
    if not counting - dataset.left_out:
        first = failures[0].reason if failures else "all groups are left out"
        what = f"none of its {total} pictures could be scored; the first: {first}"
        raise DatasetError(dataset.root, what, "mend that first")
    roads = [road for tally in saved.tallies.values() for road in tally.sums["road"].values()]
    if not any(bool(road[0].any()) for road in roads):
        what = "there is no road in any label"
        raise UnscorableError(dataset.root, what, "check which numbers mean road in this set")
    return saved.tallies, failures


# --- a run that is interrupted ----------------------------------------------------------


FILE = "progress.pt"
SAVE_EVERY = 20.0  # seconds of work that a power cut may cost, at least
SAVING = 0.05  # the share of the time that saving may take: hundreds of detectors are a gigabyte
REMEDY = "run it as before, or give another --out, or remove that file"


def fingerprint(dataset: Dataset, methods: Sequence[Method]) -> str:
    """What makes two runs the same: pictures, labels, detectors with settings, and our code."""
    files = [
        (item.name, item.group, *(_stamp(path) for path in (item.image, item.label)))
        for item in dataset.items
    ]
    code = sorted(Path(__file__).parents[1].rglob("*.py"))
    about = [(one.name, one.settings, one.threshold) for one in methods]
    groups = sorted(dataset.left_out)  # they teach prior:mean nothing
    parts = [dataset.name, dataset.split, files, groups, about, [_stamp(path) for path in code]]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _stamp(path: Path) -> tuple[str, int, int]:
    stat = path.stat() if path.exists() else None
    return str(path), stat.st_size if stat else -1, stat.st_mtime_ns if stat else -1


class SavedTallies:
    """The tallies of a run, saved now and then if there is a folder to save in.

    Raises ConfigError for a file that another run left there, or that is not the one that was
    saved: before its bytes stands their SHA-256.
    """

    def __init__(self, folder: Path | None, run: str) -> None:
        self.path = folder / FILE if folder else None
        self.run = run
        self.tallies: dict[str, Tally] = {}
        self._saved, self._pause = time.monotonic(), SAVE_EVERY
        if self.path and self.path.is_file():
            try:
                content = self.path.read_bytes()
                if hashlib.sha256(content[32:]).digest() != content[:32]:
                    raise ValueError("damaged")
            except (OSError, ValueError):
                what = "is not the progress of a run, or damaged"
                raise ConfigError(self.path, what, REMEDY) from None
            saved = torch.load(io.BytesIO(content[32:]), weights_only=True)
            if saved["run"] != run:
                what = "holds the beginning of another run (other pictures, settings or code)"
                raise ConfigError(self.path, what, REMEDY)
            self.tallies = {name: Tally(**parts) for name, parts in saved["tallies"].items()}

    def add(self, result: Scored) -> None:
        """Count one more picture, if it could be scored; save if the last time is a while ago."""
        for name, counts in result.scores.items():
            self.tallies.setdefault(name, Tally()).add(result.item, counts)
        if time.monotonic() - self._saved > self._pause:
            self.save()

    def sort(self, names: Sequence[str]) -> None:
        """Bring the pictures' rows into the order of the set, however the run came about."""
        for tally in self.tallies.values():
            tally.sort(names)

    @property
    def done(self) -> Collection[str]:
        """The names of the pictures that are counted."""
        first = next(iter(self.tallies.values()), Tally())
        return {name for name, _ in first.pictures}

    def save(self) -> None:
        """Write everything counted so far, whole or not at all."""
        if self.path is None or not self.tallies:
            return
        start, file = time.monotonic(), io.BytesIO()
        tallies = {name: vars(tally) for name, tally in self.tallies.items()}
        torch.save({"run": self.run, "tallies": tallies}, file)
        with atomic(self.path) as temporary:
            temporary.write_bytes(hashlib.sha256(file.getvalue()).digest() + file.getvalue())
        self._saved = time.monotonic()
        self._pause = max(SAVE_EVERY, (self._saved - start) / SAVING)


def forget(folder: Path) -> None:
    """Remove what a run saved in a folder: its results are safe, and a new run starts anew."""
    (folder / FILE).unlink(missing_ok=True)


# --- the threshold of a config -----------------------------------------------------------


DIGITS = 3  # of a threshold in a config


@dataclass(frozen=True)
class ThresholdChoice:
    """What was chosen for one detector, and how it does.

    default: the threshold until now. f_default: mean over the groups there.
    f, iou: mean over the groups at the chosen threshold, which these very pictures chose.
    f_held_out, iou_held_out: each group at the threshold of the others, NaN without groups.
    """

    detector: str
    settings: Settings
    threshold: float
    default: float
    f_default: float
    images: int
    f: float
    iou: float
    f_held_out: float
    iou_held_out: float


def choose_threshold(
    evaluation: Evaluation, name: str, settings: Mapping[str, Any]
) -> ThresholdChoice:
    """Choose the threshold with the highest F, averaged over groups, to three digits.

    settings: those that the run gave to the detector. Raises DatasetError when no picture
    shows road.
    """
    tally = evaluation.tallies[name]
    groups = {group: tally.road[group] for group in evaluation.detectors[name].counting}
    best = evaluation.detectors[name].best_threshold
    if math.isnan(best):
        raise DatasetError(evaluation.dataset.root, "shows no road", "give pictures with road")
    threshold = round(best, DIGITS)
    entry = detector_entry(name)
    default = entry.configured({}).threshold
    held_out = held_out_thresholds(groups) if len(groups) > 1 else {}
    return ThresholdChoice(
        name,
        entry.configured({**settings, "threshold": threshold}),
        threshold,
        default,
        _mean_figures(groups, dict.fromkeys(groups, default))[0],
        sum(group in groups for _, group in tally.pictures),
        *_mean_figures(groups, dict.fromkeys(groups, threshold)),
        *_mean_figures(groups, held_out),
    )


def _mean_figures(
    groups: Mapping[str, RoadCounts], thresholds: Mapping[str, float]
) -> tuple[float, float]:
    """F and IoU at each group's threshold, averaged over the groups with road; NaN without any."""
    outcomes = [
        metrics.decisions_at(groups[group], threshold)
        for group, threshold in thresholds.items()
        if not math.isnan(threshold) and groups[group].road.sum() > 0
    ]
    if not outcomes:
        return math.nan, math.nan
    f, iou = ([float(of(one)) for one in outcomes] for of in (metrics.f_measure, metrics.iou))
    return sum(f) / len(f), sum(iou) / len(iou)
