"""roadtorch label: machine labels of the scene layout, to look at or to train on."""

from pathlib import Path

import click

from roadtorch.cli.completion import suggest_files
from roadtorch.cli.options import PATH, SETTING, with_run
from roadtorch.runs.options import RunOptions, as_toml


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, shell_complete=suggest_files)
@click.option("--out", type=PATH, required=True, help="Folder for the labels.")
@click.option(
    "--support",
    type=click.Choice(["margin", "maximum"]),
    default="margin",
    help="Leave doubtful segments unlabelled, or give each its likeliest class.",
)
@SETTING
@click.option("--overlay", is_flag=True, help="Also write NAME.overlay.jpg.")
@with_run
@click.pass_context
def label(
    context: click.Context,
    inputs: tuple[str, ...],
    out: Path,
    support: str,
    assignments: tuple[str, ...],
    overlay: bool,
    options: RunOptions,
) -> None:
    """Label every pixel as sky (0), vertical (1), horizontal (2) or unlabelled (255).

    Each picture gives NAME.png in the folder --out. No weights and no labels are needed.
    """
    from roadtorch.layout.labeller import LabellerSettings
    from roadtorch.runs import pictures, results
    from roadtorch.runs.folder import result_folder
    from roadtorch.settings import build_settings, parse_assignments
    from roadtorch.sources.pictures import find_images

    values = {"support": support} | parse_assignments(assignments)
    settings = build_settings(LabellerSettings, values)
    kinds = ["labels", *["overlay"] * overlay]
    ends = [results.LABEL_SUFFIXES[kind] for kind in kinds]
    planned = pictures.plan(find_images(inputs, out), out, ends)
    effective = as_toml("labeller", settings)
    folder = context.with_resource(result_folder(out, effective, options.overwrite))
    method = pictures.method_of(kinds, effective)
    work = results.Labelling(settings, overlay)
    context.exit(pictures.run_pictures(planned, work, method, folder, options))
