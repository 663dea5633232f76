"""roadtorch evaluate: score detectors on labelled pictures, beside the floors."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.options import PATH, labelled_set

if TYPE_CHECKING:
    from roadtorch.evaluation.plan import Described
    from roadtorch.evaluation.progress import Progress
    from roadtorch.evaluation.runner import Plan, Result
    from roadtorch.evaluation.tally import Tally


@click.command()
@labelled_set
@click.option("--maps", "folders", multiple=True, help="Maps made elsewhere: NAME=DIR or DIR.")
@click.option("--bev", is_flag=True, help="Score in bird's-eye view (kitti-road).")
@click.option("--out", type=PATH, help="Folder for metrics.json, report.html, curves and rows.")
@click.option("--mean-from", help="Learn prior:mean on another set: NAME:ROOT.")
@click.option("--threshold-from", type=PATH, help="Thresholds that an earlier metrics.json chose.")
@click.option("--against", help="Compare all with this detector; the best one if not given.")
@click.option(
    "--montage",
    type=click.IntRange(min=0),
    default=4,
    show_default=True,
    help="Show the N best, median and worst pictures of each detector.",
)
@click.pass_context
def evaluate(
    context: click.Context,
    dataset: str,
    root: Path,
    split: str | None,
    names: tuple[str, ...],
    assignments: tuple[str, ...],
    folders: tuple[str, ...],
    bev: bool,
    out: Path | None,
    limit: int | None,
    jobs: int,
    mean_from: str | None,
    threshold_from: Path | None,
    against: str | None,
    montage: int,
) -> None:
    """Score detectors on the labelled pictures of DATASET (camvid, kitti-road, …) at ROOT.

    Every picture is read once and shown to every detector. The floors prior:rows,
    prior:triangle and, where other drives can teach it, prior:mean stand beside them.
    A run that is interrupted goes on where it was when it is started again.
    """
    from roadtorch.cli.batch import make_writable
    from roadtorch.data.catalogue import open_dataset
    from roadtorch.data.kitti import birds_eye
    from roadtorch.evaluation import comparison
    from roadtorch.evaluation.plan import described, make_plan
    from roadtorch.evaluation.progress import Progress, fingerprint
    from roadtorch.report import files, table3
    from roadtorch.report.screen import screen
    from roadtorch.version import __version__

    if out is not None:
        make_writable(out)  # now rather than after the long run
    opened = open_dataset(dataset, root, split)
    opened = birds_eye(opened) if bev else opened
    plan = make_plan(opened, _without_default(context, names, folders), assignments, mean_from,
                     folders, limit)  # fmt: skip
    about = described(plan)
    given = _given_thresholds(about, threshold_from)
    comparison.check_against(list(about), against)
    progress = Progress(out, fingerprint(plan.dataset, about))
    failures = run_pass(plan, jobs, progress)
    figures, pairs = figures_of(about, progress.tallies, given, against)
    document = files.metrics_document(
        plan.dataset, figures, failures, __version__, command_line(context)
    )
    document["paired"] = pairs
    click.echo(screen(document))
    if grid := table3.table_text(document):
        click.echo(f"\n{grid}")
    for failure in failures:
        click.echo(f"failed: {failure.item.name}: {failure.failure}", err=True)
    if out is not None:
        _write(out, plan, progress, document, failures, montage)
        progress.finish()
    context.exit(1 if failures else 0)


def _without_default(
    context: click.Context, names: tuple[str, ...], folders: tuple[str, ...]
) -> tuple[str, ...]:
    """No detector but the floors when only maps are asked for."""
    source = context.get_parameter_source("names")
    return () if folders and source is click.core.ParameterSource.DEFAULT else names


def command_line(context: click.Context) -> str:
    """The command that gives this run: arguments, then the options that are not default."""
    words, options = ["roadtorch", context.info_name or ""], []
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if isinstance(parameter, click.Argument):
            words.append(str(value))
        elif value is True:
            options.append(parameter.opts[0])
        elif value not in (None, (), False, parameter.default):
            values = value if isinstance(value, tuple) else (value,)
            options += [word for part in values for word in (parameter.opts[0], str(part))]
    return shlex.join([*words, *options])


def _given_thresholds(about: Mapping[str, "Described"], path: Path | None) -> dict[str, float]:
    from roadtorch.report.files import earlier_threshold, read_thresholds

    if path is None:
        return {}
    earlier = read_thresholds(path)
    return {
        name: earlier_threshold(path, earlier, name, one.settings) for name, one in about.items()
    }


def run_pass(plan: "Plan", jobs: int, progress: "Progress") -> list["Result"]:
    """Run what is left of the plan under a progress bar; returns what failed.

    The tallies grow in ``progress``, which is saved whatever ends the run. DatasetError
    when nothing could be scored.
    """
    from tqdm import tqdm

    from roadtorch.errors import DatasetError
    from roadtorch.evaluation import runner
    from roadtorch.signals import stop_on_signals

    failures: list[runner.Result] = []
    done, total = progress.done, len(plan.dataset.items)
    if done:
        click.echo(f"roadtorch: going on after {len(done)} of {total} pictures", err=True)
    results = runner.run(plan, jobs, done)
    bar = tqdm(results, initial=len(done), total=total, unit="image", disable=None)
    try:
        with stop_on_signals() as stop:
            for result in bar:
                if result.failure:
                    failures.append(result)
                progress.add(result)
                if stop.asked:
                    raise KeyboardInterrupt
    except BaseException:
        progress.save()
        raise
    progress.sort([item.name for item in plan.dataset.items])
    if not progress.tallies:
        what = f"none of its {total} pictures could be scored; the first: {failures[0].failure}"
        raise DatasetError(plan.dataset.root, what, "mend that first")
    return failures


def figures_of(
    about: Mapping[str, "Described"],
    tallies: Mapping[str, "Tally"],
    given: Mapping[str, float],
    against: str | None,
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Every detector's figures, and all compared with one, as metrics.json has them."""
    from roadtorch.evaluation import comparison
    from roadtorch.evaluation.summary import summarise, thresholds_of

    figures, resampled = {}, {}
    for name, one in about.items():
        found = summarise(tallies[name], one.threshold, given.get(name))
        resampled[name] = comparison.resample(tallies[name].rows, thresholds_of(found), found)
        found["ci95"] = comparison.intervals(resampled[name])
        figures[name] = {
            **found,
            "threshold_default": one.threshold,
            "settings": one.settings,
        }
    return figures, comparison.paired(resampled, against or comparison.best_of(figures))


def _write(
    out: Path,
    plan: "Plan",
    progress: "Progress",
    document: Mapping[str, Any],
    failures: Sequence["Result"],
    montage: int,
) -> None:
    """Everything that stays: figures, curves, rows, sheets of pictures, and the report."""
    from roadtorch.evaluation.outlines import outlines
    from roadtorch.files import write_text
    from roadtorch.report import files, table3
    from roadtorch.report.montage import write_montages
    from roadtorch.report.page import html

    figures = document["detectors"]
    rows = files.image_rows(progress.tallies, figures)
    curves = {name: outlines(tally) for name, tally in progress.tallies.items()}
    files.write_metrics(out / "metrics.json", document)
    files.write_metrics(out / "curves.json", curves)
    write_text(out / "images.csv", files.rows_csv(rows, failures))
    table3.write_table3(out, document, curves)
    sheets = write_montages(out, plan, progress.tallies, figures, montage) if montage else {}
    html.write_report(out / "report.html", document, curves, rows, sheets)
