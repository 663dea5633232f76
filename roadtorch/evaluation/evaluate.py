"""Score detectors on a labelled set: count every image once, then compute scores."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from roadtorch.base.errors import ConfigError, DatasetError, UnscorableError
from roadtorch.camera.camera import Camera
from roadtorch.data.dataset import Dataset, subsample_dataset
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import (
    Contender,
    apply_thresholds,
    collect_contenders,
    compute_with,
    parse_reference,
)
from roadtorch.evaluation.result import Evaluation, Failure, summarise
from roadtorch.evaluation.scoring import run_contenders
from roadtorch.evaluation.tally import Tally
from roadtorch.evaluation.uncertainty import bootstrap, compare_detectors, score_intervals
from roadtorch.layout.runtimes import REFERENCE


def evaluate(
    dataset: Dataset,
    detectors: Sequence[str | Contender] = ("fusion",),
    *,
    settings: Mapping[str, object] | None = None,
    camera: Camera | None = None,
    limit: int | None = None,
    mean_from: Dataset | None = None,
    threshold_from: Path | None = None,
    against: str | None = None,
    with_baselines: bool = True,
    measures: Sequence[Measure] = MEASURES,
    jobs: int | None = 1,
    runtime: str = REFERENCE,
    quiet: bool = True,
) -> Evaluation:
    """Score detectors and the baselines ``prior:rows``, ``prior:triangle`` and ``prior:mean``.

    Args:
        dataset: labelled set.
        detectors: names, with wildcards; weight files, configs, and folders of likelihood maps,
            as PATH or NAME=PATH.
        settings: nested values for the detectors that are named.
        camera: camera that took the images.
        limit: number of images to score, evenly spread; all if None.
        mean_from: set that ``prior:mean`` is computed on, for a set without groups.
        threshold_from: metrics.json of an earlier run whose thresholds are used.
        against: detector that all are compared with, as in ``detectors``; the best one if None.
        with_baselines: whether the baselines are scored as well.
        measures: measures to compute.
        jobs: processes, None for as many as help; the scores do not depend on it.
        runtime: library that computes the networks of the detectors, as in ``load_detector``.
        quiet: whether the progress bar is hidden.

    Returns:
        The scores, their intervals and differences, and the images that failed.

    Raises:
        ConfigError: for mistakes that are found before the run.
        DatasetError: when no image could be scored.
        UnscorableError: when no label has any road.
    """
    settings = settings or {}
    entries = collect_contenders(dataset, detectors, settings, camera, mean_from, with_baselines)
    if against is not None and against not in {entry.name for entry in entries}:
        entries.append(parse_reference(against, settings, camera))
        against = entries[-1].name
        if against in {entry.name for entry in entries[:-1]}:
            raise ConfigError(against, "names two detectors", "write NAME=PATH")
    if threshold_from is not None:
        entries = apply_thresholds(entries, threshold_from)
    entries = [compute_with(entry, runtime) for entry in entries]
    if all(entry.runtime != runtime for entry in entries):
        raise ConfigError("--runtime", "has no effect on these", "give a detector with a network")
    images = subsample_dataset(dataset, limit)
    conditions = images.items_by_condition()
    tallies, failures = tally_images(images, entries, jobs, quiet)
    scores = {
        entry.name: summarise(entry, tallies[entry.name], measures, images.left_out, conditions)
        for entry in entries
    }
    replicates = {name: bootstrap(tallies[name], scores[name], measures) for name in scores}
    best = max(scores, key=lambda name: scores[name].ranking_score)
    return Evaluation(
        images,
        {
            name: replace(detector_scores, intervals=score_intervals(replicates[name]))
            for name, detector_scores in scores.items()
        },
        compare_detectors(scores, replicates, against or best, measures),
        failures,
        tallies,
        measures,
    )


def tally_images(
    dataset: Dataset, entries: Sequence[Contender], jobs: int | None, quiet: bool
) -> tuple[Mapping[str, Tally], list[Failure]]:
    """Count every image for every contender; an image that fails counts for none of them."""
    tallies, failures = {entry.name: Tally() for entry in entries}, list[Failure]()
    for item, counts in run_contenders(dataset, entries, jobs=jobs, quiet=quiet):
        if isinstance(counts, Failure):
            failures.append(counts)
            continue
        for name, part in counts.items():
            tallies[name].add(item, part)
    first = failures[0].reason if failures else "all groups are left out"
    roads = [counts.road for tally in tallies.values() for counts in tally.road.values()]
    if not {group for tally in tallies.values() for group in tally.road} - dataset.left_out:
        message = f"none of the {len(dataset.items)} images could be scored; first failure: {first}"
        raise DatasetError(dataset.root, message, "fix that first")
    if not any(bool(road.any()) for road in roads):
        message, hint = "no label has any road", "check which label values mean road"
        if failures:
            message = f"{message} in the {len(dataset.items) - len(failures)} images that could be "
            message, hint = f"{message}scored; first failure: {first}", "fix that first"
        raise UnscorableError(dataset.root, message, hint)
    return tallies, failures
