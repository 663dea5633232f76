"""Score detectors on a labelled set: every picture once, then figures and comparisons."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.errors import DatasetError, unknown_name
from roadtorch.evaluation.document import earlier_thresholds
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Method, methods_for
from roadtorch.evaluation.progress import SavedTallies, fingerprint
from roadtorch.evaluation.result import Evaluation, Failure
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.summary import summarise
from roadtorch.evaluation.tally import Scored, Tally
from roadtorch.evaluation.uncertainty import best_of, compare, intervals, resample

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
    could be scored.
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
    return saved.tallies, failures
