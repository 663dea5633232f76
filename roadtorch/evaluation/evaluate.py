"""Score detectors on a labelled set: every picture once, then figures and comparisons."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from roadtorch.base.errors import DatasetError, UnscorableError, unknown_name
from roadtorch.base.progress import Progress
from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Contender, contenders
from roadtorch.evaluation.result import Evaluation, Failure, summarise
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.tally import Tally
from roadtorch.evaluation.uncertainty import compare, intervals, resample


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
    quiet: bool = True,
) -> Evaluation:
    """Score detectors beside the baselines ``prior:rows``, ``prior:triangle`` and ``prior:mean``.

    detectors: names, with wildcards. settings: nested values for those that are named.
    maps: by name, folders of likelihood maps made elsewhere.
    limit: look at so many pictures only, evenly spread. mean_from: the set that teaches
    ``prior:mean`` where the groups of this one cannot. threshold_from: the metrics.json of
    an earlier run whose thresholds are taken. against: the detector that all are compared
    with, the best one if not given. measures: what is measured. jobs: processes, None for what
    pays; the figures do not depend on it. quiet: no progress is shown.

    Raises ConfigError for what can be refused before the run, DatasetError when no picture
    could be scored, UnscorableError when no label has any road.
    """
    entries = contenders(dataset, detectors, settings or {}, maps or {}, mean_from, threshold_from)
    return evaluated(dataset, entries, limit, against, measures, jobs, quiet)


def evaluated(
    dataset: Dataset,
    entries: Sequence[Contender],
    limit: int | None = None,
    against: str | None = None,
    measures: Sequence[Measure] = MEASURES,
    jobs: int | None = 1,
    quiet: bool = True,
) -> Evaluation:
    """Score contenders as they are; the rest, and what it raises, as for ``evaluate``."""
    names = [entry.name for entry in entries]
    if against is not None and against not in names:
        raise unknown_name("detector of this run", against, names)
    pictures = every_kth(dataset, limit)
    conditions = pictures.by_condition()
    tallies, failures = count_pictures(pictures, entries, jobs, quiet)
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


def count_pictures(
    dataset: Dataset, entries: Sequence[Contender], jobs: int | None, quiet: bool
) -> tuple[Mapping[str, Tally], list[Failure]]:
    """Count every picture for every contender; a picture that fails counts for none of them."""
    tallies, failures = {entry.name: Tally() for entry in entries}, list[Failure]()
    with closing(score(dataset, entries, jobs)) as results:
        for result in Progress(results, total=len(dataset.items), unit="image", quiet=quiet):
            if result.failure:
                failures.append(Failure(result.item.name, result.item.group, result.failure))
            for name, counts in result.scores.items():
                tallies[name].add(result.item, counts)
    roads = [counts.road for tally in tallies.values() for counts in tally.road.values()]
    if not {group for tally in tallies.values() for group in tally.road} - dataset.left_out:
        first = failures[0].reason if failures else "all groups are left out"
        message = f"none of its {len(dataset.items)} pictures could be scored; the first: {first}"
        raise DatasetError(dataset.root, message, "mend that first")
    if not any(bool(road.any()) for road in roads):
        message = "there is no road in any label"
        raise UnscorableError(dataset.root, message, "check which numbers mean road in this set")
    return tallies, failures
