"""roadtorch evaluate, roadtorch tune: detectors over labelled pictures, beside the baselines."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.completion import suggest_detectors
from roadtorch.cli.options import (
    CAMERA,
    PATH,
    LabelledOptions,
    as_toml,
    command_line,
    with_labelled,
)

if TYPE_CHECKING:
    from roadtorch.evaluation.result import Evaluation


@click.command()
@with_labelled
@CAMERA
@click.option("--maps", "folders", multiple=True, help="Maps made elsewhere: NAME=DIR or DIR.")
@click.option("--bev", is_flag=True, help="Score in bird's-eye view (kitti-road).")
@click.option("--conditions", type=PATH, help="CSV with each picture's conditions, for ROOT's own.")
@click.option("--out", type=PATH, help="Folder for metrics.json, report.html, curves and rows.")
@click.option("--mean-from", help="Learn prior:mean on another set: NAME:ROOT.")
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
    help="Show the N best, median and worst pictures of each detector.",
)
@click.pass_context
def evaluate(
    context: click.Context,
    labelled: LabelledOptions,
    camera: Path | None,
    folders: tuple[str, ...],
    bev: bool,
    conditions: Path | None,
    out: Path | None,
    mean_from: str | None,
    threshold_from: Path | None,
    against: str | None,
    montage: int,
) -> None:
    """Score detectors on the labelled pictures of DATASET (camvid, kitti-road, …) at ROOT.

    Every picture is read once and shown to every detector. Beside them stand blind
    baselines, which never look at the picture: prior:rows, prior:triangle and, where other
    groups can teach it, prior:mean.
    Start an interrupted run again to resume it.
    """
    from roadtorch.base.settings import merge, parse_assignments
    from roadtorch.data.catalogue import open_named
    from roadtorch.data.folder import with_conditions
    from roadtorch.data.kitti import birds_eye
    from roadtorch.data.maps import parse_maps
    from roadtorch.evaluation.evaluate import evaluate as score
    from roadtorch.evaluation.report.tables import screen
    from roadtorch.run.folder import output_lock
    from roadtorch.run.workers import settle

    settle(threads=1)
    if out is not None:
        context.with_resource(output_lock(out))  # now rather than after the long run
    dataset, names = labelled.opened(), labelled.names
    default = click.core.ParameterSource.DEFAULT
    if folders and context.get_parameter_source("names") is default:
        names = ()  # no detector but the baselines when only maps are asked for
    values = merge(camera_settings(camera, names), parse_assignments(labelled.assignments))
    if conditions is not None:
        dataset = with_conditions(dataset, conditions)
    evaluation = score(
        birds_eye(dataset) if bev else dataset,
        names,
        settings=values,
        maps=parse_maps(folders),
        limit=labelled.limit,
        mean_from=None if mean_from is None else open_named(mean_from),
        threshold_from=threshold_from,
        against=against,
        jobs=labelled.jobs,
        quiet=False,
    )
    click.echo(screen(evaluation))
    tell_failures(evaluation)
    if out is not None:
        from roadtorch.evaluation.report.files import write  # with what draws, which takes a while

        write(evaluation, out, command_line(context), montage)
    context.exit(1 if evaluation.failures else 0)


@click.command()
@with_labelled
@click.option("--out", type=PATH, required=True, help="Folder for the configs, NAME.toml.")
@click.pass_context
def tune(
    context: click.Context,
    labelled: LabelledOptions,
    out: Path,
) -> None:
    """Choose thresholds on the labelled pictures of DATASET at ROOT.

    The threshold with the highest F, averaged over the groups, goes into OUT/NAME.toml
    together with the detector's settings and this command; use it with infer --config.
    Shown beside it is how well such a choice carries over: F and IoU of each group at the
    threshold that the other groups choose.
    """
    from roadtorch.base.atomic import write_text
    from roadtorch.base.settings import parse_assignments
    from roadtorch.evaluation.evaluate import evaluate as score
    from roadtorch.evaluation.tuning import choice_table, choose_threshold, provenance
    from roadtorch.run.folder import output_lock
    from roadtorch.run.workers import settle

    settle(threads=1)
    context.with_resource(output_lock(out))
    settings = parse_assignments(labelled.assignments)
    evaluation = score(
        labelled.opened(),
        labelled.names,
        settings=settings,
        limit=labelled.limit,
        jobs=labelled.jobs,
        quiet=False,
    )
    choices = [
        choose_threshold(evaluation, name, settings)
        for name, figures in evaluation.detectors.items()
        if not figures.is_baseline
    ]
    for choice in choices:
        path = out / f"{choice.detector.replace(':', '-')}.toml"
        lines = provenance(choice, evaluation, command_line(context))
        comment = "".join(f"# {line}\n" for line in lines)
        write_text(path, f"{comment}\n{as_toml(choice.detector, choice.settings)}\n")
    click.echo(choice_table(choices).text())
    tell_failures(evaluation)
    context.exit(1 if evaluation.failures else 0)


def camera_settings(path: Path | None, names: Sequence[str]) -> dict[str, Any]:
    """What a camera's file sets for all detectors of those names; nothing without a file.

    Raises as ``Camera.read`` and ``expand_names`` do.
    """
    from roadtorch.camera.camera import Camera
    from roadtorch.detectors.catalogue import detector_entry
    from roadtorch.detectors.detector import DetectorSettings
    from roadtorch.evaluation.methods import expand_names

    if path is None:
        return {}
    camera = Camera.read(path)
    kinds = [detector_entry(name).settings for name in expand_names(names)]
    for_all = [camera.settings_for(kind) for kind in kinds or [DetectorSettings]]
    return min(for_all, key=len)  # the ego car for each, the horizon where every one has it


def tell_failures(evaluation: "Evaluation") -> None:
    """One line on stderr for each picture that could not be scored."""
    for failure in evaluation.failures:
        click.echo(f"failed: {failure.image}: {failure.reason}", err=True)
