"""Score detectors on a labelled set: every picture once, then figures and comparisons.

A run that is interrupted goes on where it was: its counts so far are in one file.
"""

import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
from roadtorch.evaluation.measures import MAXF, MEASURES
from roadtorch.evaluation.methods import Method, methods_for
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.result import Evaluation, Failure, held_out_thresholds, summarise
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.tally import Scored, Tally
from roadtorch.evaluation.uncertainty import compare, intervals, resample
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
    scores = MAXF.known({name: one.headline for name, one in figures.items()})
    best = max(scores, key=scores.__getitem__, default=names[0])
    return Evaluation(
        pictures,
        {name: replace(figures[name], intervals=intervals(draws[name])) for name in names},
        compare(figures, draws, against or best, measures),
        failures,
        tallies,
        measures,
    )


def count_all(
    dataset: Dataset, methods: Sequence[Method], jobs: int, keep_in: Path | None, watch: Watch
) -> tuple[Mapping[str, Tally], list[Failure]]:
    """Run what is left of the pass; the tallies are saved whatever ends it."""
    file = keep_in / FILE if keep_in else None
    run, failures = fingerprint(dataset, methods), list[Failure]()
    tallies = read_progress(file, run) if file and file.is_file() else {}
    done = {name for one in tallies.values() for name, _ in one.pictures}
    saved, pause = time.monotonic(), SAVE_EVERY
    try:
        for result in watch(score(dataset, methods, jobs, done), len(done), len(dataset.items)):
            if result.failure:
                failures.append(Failure(result.item.name, result.item.group, result.failure))
            for name, counts in result.scores.items():
                tallies.setdefault(name, Tally()).add(result.item, counts)
            if file and tallies and time.monotonic() - saved > pause:
                start = time.monotonic()
                write_progress(file, run, tallies)
                saved = time.monotonic()
                pause = max(SAVE_EVERY, (saved - start) / SAVING)
    except BaseException:
        if file and tallies:
            write_progress(file, run, tallies)
        raise
    order = [item.name for item in dataset.items]
    for tally in tallies.values():
        tally.sort(order)
    counting = {group for tally in tallies.values() for _, group in tally.pictures}
    if not counting - dataset.left_out:
        first = failures[0].reason if failures else "all groups are left out"
        what = f"none of its {len(dataset.items)} pictures could be scored; the first: {first}"
        raise DatasetError(dataset.root, what, "mend that first")
    roads = [road for tally in tallies.values() for road in tally.sums["road"].values()]
    if not any(bool(road[0].any()) for road in roads):
        what = "there is no road in any label"
        raise UnscorableError(dataset.root, what, "check which numbers mean road in this set")
    return tallies, failures


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


def read_progress(path: Path, run: str) -> dict[str, Tally]:
    """The tallies that ``write_progress`` saved.

    Raises ConfigError for a file that another run left there, or that is not the one that was
    saved: before its bytes stands their SHA-256.
    """
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[32:]).digest() != content[:32]:
            raise ValueError("damaged")
    except (OSError, ValueError):
        raise ConfigError(path, "is not the progress of a run, or damaged", REMEDY) from None
    saved = torch.load(io.BytesIO(content[32:]), weights_only=True)
    if saved["run"] != run:
        what = "holds the beginning of another run (other pictures, settings or code)"
        raise ConfigError(path, what, REMEDY)
    return {name: Tally(**parts) for name, parts in saved["tallies"].items()}


def write_progress(path: Path, run: str, tallies: Mapping[str, Tally]) -> None:
    """Write everything counted so far, whole or not at all; run: its fingerprint."""
    file = io.BytesIO()
    parts = {name: vars(tally) for name, tally in tallies.items()}
    torch.save({"run": run, "tallies": parts}, file)
    with atomic(path) as temporary:
        temporary.write_bytes(hashlib.sha256(file.getvalue()).digest() + file.getvalue())


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
