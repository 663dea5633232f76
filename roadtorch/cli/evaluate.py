"""roadtorch evaluate: score detectors on labelled pictures, beside the baselines."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import CAMERA, PATH, labelled_set
from roadtorch.cli.suggestions import suggest_detectors, suggest_rooted_datasets

if TYPE_CHECKING:
    from roadtorch.data.dataset import Dataset
    from roadtorch.evaluation.result import Evaluation


@click.command()
@labelled_set
@CAMERA
@click.option("--maps", "folders", multiple=True, help="Maps made elsewhere: NAME=DIR or DIR.")
@click.option("--bev", is_flag=True, help="Score in bird's-eye view (kitti-road).")
@click.option("--conditions", type=PATH, help="CSV with each picture's conditions, for ROOT's own.")
@click.option("--out", type=PATH, help="Folder for metrics.json, report.html, curves and rows.")
@click.option(
    "--mean-from",
    shell_complete=suggest_rooted_datasets,
    help="Learn prior:mean on another set: NAME:ROOT.",
)
@click.option("--threshold-from", type=PATH, help="Thresholds that an earlier metrics.json chose.")
@click.option(
    "--against",
    shell_complete=suggest_detectors,
    help="Compare all with this detector; the best one if not given.",
)
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
    camera: Path | None,
    folders: tuple[str, ...],
    bev: bool,
    conditions: Path | None,
    out: Path | None,
    left_out: tuple[str, ...],
    limit: int | None,
    jobs: int,
    mean_from: str | None,
    threshold_from: Path | None,
    against: str | None,
    montage: int,
) -> None:
    """Score detectors on the labelled pictures of DATASET (camvid, kitti-road, …) at ROOT.

    Every picture is read once and shown to every detector. Beside them stand blind
    baselines, which never look at the picture: prior:rows, prior:triangle and, where other
    groups can teach it, prior:mean.
    A run that is interrupted goes on where it was when it is started again.
    """
    from roadtorch.cli.labelled import camera_settings, opened, watched
    from roadtorch.data.catalogue import open_named
    from roadtorch.data.maps import parse_maps
    from roadtorch.evaluation.evaluate import evaluate as score
    from roadtorch.runs.claim import claimed
    from roadtorch.settings import merge, parse_assignments

    if out is not None:
        context.with_resource(claimed(out))  # now rather than after the long run
    labelled = opened(dataset, root, split, left_out)
    chosen = _without_default(context, names, folders)
    values = merge(camera_settings(camera, chosen), parse_assignments(assignments))
    evaluation = score(
        _seen(labelled, conditions, bev),
        chosen,
        settings=values,
        maps=parse_maps(folders),
        limit=limit,
        mean_from=None if mean_from is None else open_named(mean_from),
        threshold_from=threshold_from,
        against=against,
        jobs=jobs,
        keep_in=out,
        watch=watched,
    )
    _tell(evaluation)
    if out is not None:
        _keep(evaluation, out, context, montage)
    context.exit(1 if evaluation.failures else 0)


def _seen(labelled: "Dataset", conditions: Path | None, from_above: bool) -> "Dataset":
    """The set with the conditions of a table, where one is given, seen as the options say."""
    from roadtorch.data.conditions import with_conditions
    from roadtorch.data.kitti import birds_eye

    if conditions is not None:
        labelled = with_conditions(labelled, conditions)
    return birds_eye(labelled) if from_above else labelled


def _tell(evaluation: "Evaluation") -> None:
    """Tables on stdout, failures on stderr."""
    from roadtorch.cli.labelled import tell_failures
    from roadtorch.report.screen import screen
    from roadtorch.report.table3 import table_text

    click.echo("\n\n".join(filter(None, (screen(evaluation), table_text(evaluation)))))
    tell_failures(evaluation)


def _keep(evaluation: "Evaluation", out: Path, context: click.Context, montage: int) -> None:
    """Write the results; the progress that was saved for an interruption is not needed then."""
    from roadtorch.cli.labelled import command_line
    from roadtorch.evaluation.tally import forget
    from roadtorch.report.files import write  # with what draws, which takes a while

    write(evaluation, out, command_line(context), montage)
    forget(out)


def _without_default(
    context: click.Context, names: tuple[str, ...], folders: tuple[str, ...]
) -> tuple[str, ...]:
    """No detector but the baselines when only maps are asked for."""
    source = context.get_parameter_source("names")
    return () if folders and source is click.core.ParameterSource.DEFAULT else names
