"""roadtorch evaluate: score detectors on labelled pictures, beside the floors."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from roadtorch.evaluation.datasets import Dataset
    from roadtorch.evaluation.runner import Plan, Result, Tally

FLOORS = ("prior:rows", "prior:triangle")  # in every run; prior:mean joins where it can
PATH = click.Path(path_type=Path)


@click.command()
@click.argument("dataset")
@click.argument("root", type=PATH)
@click.option("--split", help="Part of the data set; camvid: dev (default), train, val.")
@click.option(
    "--detector",
    "names",
    multiple=True,
    default=("fusion",),
    show_default=True,
    help="Detector to score; may be given several times, with wildcards ('cpf*').",
)
@click.option("--set", "assignments", multiple=True, help="Setting of the detectors: key=value.")
@click.option("--out", type=PATH, help="Folder for metrics.json, images.csv and montages.")
@click.option("--limit", type=click.IntRange(min=1), help="Look at this many pictures only.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--mean-from", help="Learn prior:mean on another set: NAME:ROOT.")
@click.option("--threshold-from", type=PATH, help="Thresholds that an earlier metrics.json chose.")
@click.option(
    "--montage", type=click.IntRange(min=1), help="Sheets of the N best, median and worst pictures."
)
@click.pass_context
def evaluate(
    context: click.Context,
    dataset: str,
    root: Path,
    split: str | None,
    names: tuple[str, ...],
    assignments: tuple[str, ...],
    out: Path | None,
    limit: int | None,
    jobs: int,
    mean_from: str | None,
    threshold_from: Path | None,
    montage: int | None,
) -> None:
    """Score detectors on the labelled pictures of DATASET (camvid, idd-lite, folder) at ROOT.

    Every picture is read once and shown to every detector. The floors prior:rows,
    prior:triangle and, where other drives can teach it, prior:mean stand beside them.
    """
    from roadtorch import __version__
    from roadtorch.evaluation import report, runner
    from roadtorch.evaluation.datasets import open_dataset

    _prepare_folder(out, montage)
    opened = open_dataset(dataset, root, split)
    detectors = _detectors(names, assignments)
    earlier = report.read_thresholds(threshold_from) if threshold_from else None
    masks = _mean_masks(opened, mean_from)
    plan = runner.Plan(runner.every_kth(opened, limit), detectors, masks)
    given = _given_thresholds(plan, threshold_from, earlier)
    tallies, failures = _run(plan, jobs)
    figures = _figures(plan, tallies, given)
    click.echo(
        "\n\n".join(filter(None, (report.score_table(figures), report.layout_table(figures))))
    )
    for failure in failures:
        click.echo(f"failed: {failure.item.name}: {failure.failure}", err=True)
    if out is not None:
        command = command_line(context)
        document = report.metrics_document(plan.dataset, figures, failures, __version__, command)
        report.write_metrics(out / "metrics.json", document)
        _write_rows(out, tallies, figures, failures)
        if montage:
            _write_montages(out, plan, tallies, figures, montage)
    context.exit(1 if failures else 0)


def command_line(context: click.Context) -> str:
    """The command that gives this run: arguments, then the options that are not default."""
    words, options = ["roadtorch", "evaluate"], []
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if isinstance(parameter, click.Argument):
            words.append(str(value))
        elif value not in (None, (), parameter.default):
            values = value if isinstance(value, tuple) else (value,)
            options += [word for part in values for word in (parameter.opts[0], str(part))]
    return shlex.join([*words, *options])


def _prepare_folder(out: Path | None, montage: int | None) -> None:
    """Make the folder before the long run rather than fail after it."""
    from roadtorch.cli.batch import make_writable
    from roadtorch.errors import ConfigError

    if out is not None:
        make_writable(out)
    elif montage:
        raise ConfigError("--montage", "needs a folder to write to", "add --out DIR")


def expand_names(names: Sequence[str]) -> list[str]:
    """Detector names with wildcards expanded, each once, in the order given.

    Raises ConfigError for a name or a pattern that fits nothing.
    """
    from fnmatch import filter as matching

    from roadtorch.detectors import detector_entry, list_detectors
    from roadtorch.errors import unknown_name
    from roadtorch.evaluation.floors import MEAN

    found: dict[str, None] = {}
    for name in names:
        if name == MEAN:  # the evaluator's own
            continue
        is_pattern = any(letter in name for letter in "*?[")
        matches = matching(list_detectors(), name) if is_pattern else [detector_entry(name).name]
        if not matches:
            raise unknown_name("detector", name, list_detectors())
        found.update(dict.fromkeys(matches))
    return list(found)


def _detectors(names: Sequence[str], assignments: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Settings by detector: those of the command line, and none for floors nobody named."""
    from roadtorch.detectors import detector_entry
    from roadtorch.settings import build_settings, parse_assignments

    values = parse_assignments(assignments)
    chosen = expand_names(names)
    detectors = {name: values for name in chosen}
    detectors |= {floor: {} for floor in FLOORS if floor not in chosen}
    for name, given in detectors.items():
        build_settings(detector_entry(name).settings, given)  # refuse before the run
    return detectors


def _mean_masks(dataset: "Dataset", mean_from: str | None) -> dict[str, Any]:
    """The mean masks for prior:mean, by drive; empty where there is nothing to learn from."""
    from roadtorch.errors import ConfigError
    from roadtorch.evaluation import floors
    from roadtorch.evaluation.datasets import open_dataset

    groups = dataset.groups()
    if mean_from is None:
        return floors.means_of_others(floors.road_shares(dataset)) if len(groups) > 1 else {}
    if len(groups) > 1:
        what = f"is not for {dataset.name}, whose drives teach each other"
        raise ConfigError("--mean-from", what, "leave it out")
    name, colon, root = mean_from.partition(":")
    if not colon:
        raise ConfigError(mean_from, "is not NAME:ROOT", "for example camvid:data/camvid")
    mean = floors.mean_of(floors.road_shares(open_dataset(name, Path(root))))
    return {group: mean for group in groups or [""]}


def _given_thresholds(
    plan: "Plan", path: Path | None, earlier: Mapping[str, tuple[float, dict[str, Any]]] | None
) -> dict[str, float]:
    from roadtorch.evaluation.report import earlier_threshold

    if path is None or earlier is None:
        return {}
    return {
        name: earlier_threshold(path, earlier, name, settings)
        for name, (settings, _) in _settings(plan).items()
    }


def _settings(plan: "Plan") -> dict[str, tuple[dict[str, Any], float]]:
    """Every detector's settings, all of them but the threshold, and its default threshold."""
    from roadtorch.detectors import detector_entry
    from roadtorch.evaluation.floors import MEAN
    from roadtorch.evaluation.runner import MEAN_THRESHOLD
    from roadtorch.settings import build_settings

    found: dict[str, tuple[dict[str, Any], float]] = {}
    for name, values in plan.detectors.items():
        settings = build_settings(detector_entry(name).settings, values).model_dump(mode="json")
        default = settings.pop("threshold")
        found[name] = (settings, default)
    return {**found, MEAN: ({}, MEAN_THRESHOLD)} if plan.mean_masks else found


def _run(plan: "Plan", jobs: int) -> tuple[dict[str, "Tally"], list["Result"]]:
    """Run the plan under a progress bar; DatasetError when nothing could be scored."""
    from tqdm import tqdm

    from roadtorch.errors import DatasetError
    from roadtorch.evaluation import runner

    tallies: dict[str, runner.Tally] = {}
    failures: list[runner.Result] = []
    total = len(plan.dataset.items)
    for result in tqdm(runner.run(plan, jobs), total=total, unit="image", disable=None):
        if result.failure:
            failures.append(result)
        for name, score in result.scores.items():
            tallies.setdefault(name, runner.Tally()).add(result.item, score)
    if not tallies:
        what = f"none of its {total} pictures could be scored; the first: {failures[0].failure}"
        raise DatasetError(plan.dataset.root, what, "mend that first")
    return tallies, failures


def _figures(
    plan: "Plan", tallies: Mapping[str, "Tally"], given: Mapping[str, float]
) -> dict[str, dict[str, Any]]:
    from roadtorch.evaluation.summary import summarise

    settings = _settings(plan)
    return {
        name: {
            **summarise(tally, settings[name][1], given.get(name)),
            "threshold_default": settings[name][1],
            "settings": settings[name][0],
        }
        for name, tally in tallies.items()
    }


def _write_rows(
    out: Path,
    tallies: Mapping[str, "Tally"],
    figures: Mapping[str, Mapping[str, Any]],
    failures: Sequence["Result"],
) -> None:
    from roadtorch.evaluation import report, runner
    from roadtorch.image import write_text

    thresholds = {name: report.thresholds_of(figures[name], runner.WHOLE) for name in tallies}
    write_text(out / "images.csv", report.image_rows(tallies, thresholds, failures))


def _write_montages(
    out: Path,
    plan: "Plan",
    tallies: Mapping[str, "Tally"],
    figures: Mapping[str, Mapping[str, Any]],
    count: int,
) -> None:
    """Three sheets for every detector but the floors."""
    from roadtorch.evaluation import report, runner, summary
    from roadtorch.evaluation.montage import write_montage

    found = runner.looks(plan)
    for name in plan.detectors:
        if name in FLOORS:
            continue
        thresholds = report.thresholds_of(figures[name], runner.WHOLE)
        order = summary.ranked(tallies[name].rows, thresholds)
        parts = {"best": order[:count], "median": order[summary.middle(len(order), count)]}
        parts["worst"] = order[::-1][:count]
        for part, chosen in parts.items():
            path = out / f"montage.{name.replace(':', '-')}.{part}.png"
            if chosen:
                write_montage(path, plan.dataset, found[name], chosen, thresholds)
