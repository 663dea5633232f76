"""Score detectors on a labelled set: every picture once, then figures and comparisons.

A run that is interrupted goes on where it was: its counts so far are in one file.
"""

import io
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from roadtorch.base.atomic import digest_of
from roadtorch.base.errors import DatasetError, UnscorableError, unknown_name
from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.detector import DetectorSettings
from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.measures import IOU, MEASURES, F
from roadtorch.evaluation.methods import Contender, contenders
from roadtorch.evaluation.result import Evaluation, Failure, summarise
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.tally import Scored, Tally
from roadtorch.evaluation.uncertainty import compare, intervals, resample
from roadtorch.run.memo import keep, kept, key_of

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
    jobs: int | None = 1,
    keep_in: Path | None = None,
    watch: Watch = unwatched,
) -> Evaluation:
    """Score detectors beside the baselines ``prior:rows``, ``prior:triangle`` and ``prior:mean``.

    detectors: names, with wildcards. settings: nested values for those that are named.
    maps: by name, folders of likelihood maps made elsewhere.
    limit: look at so many pictures only, evenly spread. mean_from: the set that teaches
    ``prior:mean`` where the groups of this one cannot. threshold_from: the metrics.json of
    an earlier run whose thresholds are taken. against: the detector that all are compared
    with, the best one if not given. measures: what is measured. jobs: processes, None for what
    pays; the figures do not depend on it.
    keep_in: a folder that keeps what is counted, so that an interrupted run goes on when it
    is started again; ``forget`` it when the result is safe. watch: sees the results pass,
    and may raise to interrupt.

    Raises ConfigError for what can be refused before the run, DatasetError when no picture
    could be scored, UnscorableError when no label has any road.
    """
    entries = contenders(dataset, detectors, settings or {}, maps or {}, mean_from, threshold_from)
    return evaluated(dataset, entries, limit, against, measures, jobs, keep_in, watch)


def evaluated(
    dataset: Dataset,
    entries: Sequence[Contender],
    limit: int | None = None,
    against: str | None = None,
    measures: Sequence[Measure] = MEASURES,
    jobs: int | None = 1,
    keep_in: Path | None = None,
    watch: Watch = unwatched,
) -> Evaluation:
    """Score contenders as they are; the rest, and what it raises, as for ``evaluate``."""
    names = [entry.name for entry in entries]
    if against is not None and against not in names:
        raise unknown_name("detector of this run", against, names)
    pictures = every_kth(dataset, limit)
    conditions = pictures.by_condition()
    tallies, failures = count_all(pictures, entries, jobs, keep_in, watch)
    figures = {
        entry.name: summarise(entry, tallies[entry.name], measures, pictures.left_out, conditions)
        for entry in entries
    }
    draws = {name: resample(tallies[name], figures[name], measures) for name in names}
    best = max(names, key=lambda name: figures[name].rank)
    return Evaluation(
        pictures,
        {name: replace(figures[name], intervals=intervals(draws[name])) for name in names},
        compare(figures, draws, against or best, measures),
        failures,
        tallies,
        measures,
    )


def count_all(
    dataset: Dataset,
    entries: Sequence[Contender],
    jobs: int | None,
    keep_in: Path | None,
    watch: Watch,
) -> tuple[Mapping[str, Tally], list[Failure]]:
    """Run what is left of the pass; the tallies are saved whatever ends it."""
    file = keep_in / FILE if keep_in else None
    key, failures = key_of_run(dataset, entries) if file else "", list[Failure]()
    tallies = read_progress(file, key) if file else {}
    done = {name for tally in tallies.values() for name, _ in tally.pictures}
    saved, pause = time.monotonic(), SAVE_EVERY
    try:
        for result in watch(score(dataset, entries, jobs, done), len(done), len(dataset.items)):
            if result.failure:
                failures.append(Failure(result.item.name, result.item.group, result.failure))
            for name, counts in result.scores.items():
                tallies.setdefault(name, Tally()).add(result.item, counts)
            if file and tallies and time.monotonic() - saved > pause:
                start = time.monotonic()
                write_progress(file, key, tallies)
                saved = time.monotonic()
                pause = max(SAVE_EVERY, (saved - start) / SAVING)
    except BaseException:
        if file and tallies:
            write_progress(file, key, tallies)
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


FILE = "progress.npz"
SAVE_EVERY = 20.0  # seconds of work that a power cut may cost, at least
SAVING = 0.05  # the share of the time that saving may take: hundreds of detectors are a gigabyte


def key_of_run(dataset: Dataset, entries: Sequence[Contender]) -> str:
    """A key of all that the counts depend on: pictures, labels, contenders, by their bytes."""
    items = [
        (item.name, item.group, digest_of(item.image), digest_of(item.label))
        for item in dataset.items
    ]
    groups = sorted(dataset.left_out)  # they teach prior:mean nothing
    made_of = [(entry.name, entry.settings, entry.threshold, entry.digest()) for entry in entries]
    return key_of(dataset.name, dataset.split, items, groups, made_of)


def read_progress(path: Path, key: str) -> dict[str, Tally]:
    """The tallies that ``write_progress`` saved under that key; none of another run."""
    arrays = kept(path, key)
    if arrays is None:
        return {}
    saved = torch.load(io.BytesIO(arrays["tallies"].numpy().tobytes()), weights_only=True)
    return {name: Tally(**parts) for name, parts in saved.items()}


def write_progress(path: Path, key: str, tallies: Mapping[str, Tally]) -> None:
    """Write everything counted so far, whole or not at all."""
    file = io.BytesIO()
    torch.save({name: vars(tally) for name, tally in tallies.items()}, file)
    data = bytearray(file.getvalue())  # no view of it: see ``write_npy``
    keep(path, key, {"tallies": torch.frombuffer(data, dtype=torch.uint8)})


def forget(folder: Path) -> None:
    """Remove what a run saved in a folder: its results are safe, and a new run starts anew."""
    (folder / FILE).unlink(missing_ok=True)


# --- the threshold of a config -----------------------------------------------------------


DIGITS = 3  # of a threshold in a config


@dataclass(frozen=True)
class ThresholdChoice:
    """What was chosen for one detector, and how it does.

    settings: with the chosen threshold; default: the threshold until now. at_default, chosen:
    F and IoU at both, on the very pictures that chose; held_out: each group at the threshold of
    the others, nothing without groups.
    """

    detector: str
    settings: DetectorSettings
    default: float
    images: float
    at_default: Figures
    chosen: Figures
    held_out: Figures


def choose_threshold(
    evaluation: Evaluation, name: str, settings: Mapping[str, Any]
) -> ThresholdChoice:
    """Choose the threshold with the highest F, averaged over groups, to three digits.

    settings: those that the run gave to the detector. Raises DatasetError when no picture
    shows road.
    """
    figures = evaluation.detectors[name]
    if math.isnan(figures.best_threshold):
        raise DatasetError(evaluation.dataset.root, "shows no road", "give pictures with road")
    entry, tally = detector_entry(name), evaluation.tallies[name]
    tuned = entry.configured({**settings, "threshold": round(figures.best_threshold, DIGITS)})
    default = entry.configured({}).threshold
    at_default, chosen = (
        summarise(
            replace(figures.contender, chosen=threshold), tally, (F, IOU), evaluation.left_out
        ).headline
        for threshold in (default, tuned.threshold)
    )
    held_out = figures.headline if len(figures.groups) > 1 else {}
    images = figures.headline["images"]
    return ThresholdChoice(name, tuned, default, images, at_default, chosen, held_out)
