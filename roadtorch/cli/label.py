"""roadtorch label: machine labels of the scene layout, to look at or to train on."""

from pathlib import Path

import click

from roadtorch.cli.options import JOBS, OVERWRITE, PATH, QUIET, SETTING
from roadtorch.cli.suggestions import suggest_files


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, shell_complete=suggest_files)
@click.option("--out", type=PATH, required=True, help="Folder for the labels.")
@click.option(
    "--support",
    type=click.Choice(["margin", "maximum"]),
    default="margin",
    show_default=True,
    help="Leave doubtful segments unlabelled, or give each its likeliest class.",
)
@SETTING
@click.option("--overlay", is_flag=True, help="Also write NAME.overlay.jpg.")
@JOBS
@OVERWRITE
@QUIET
@click.pass_context
def label(
    context: click.Context,
    inputs: tuple[str, ...],
    out: Path,
    support: str,
    assignments: tuple[str, ...],
    overlay: bool,
    jobs: int,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Label every pixel as sky (0), vertical (1), horizontal (2) or unlabelled (255).

    Each picture gives NAME.png in the folder --out. No weights and no labels are needed.
    """
    from roadtorch.cli import config
    from roadtorch.runs import batch, layouts, results
    from roadtorch.runs.claim import claimed

    settings = layouts.labeller_settings(support, assignments)
    suffixes = layouts.SUFFIXES if overlay else {"labels": layouts.SUFFIXES["labels"]}
    planned = batch.plan(inputs, out, suffixes)
    effective = config.as_toml("labeller", settings)
    context.with_resource(claimed(out))
    results.keep_config(out, effective, overwrite)
    method = batch.method_of(suffixes, effective)
    options = batch.Options(jobs, overwrite, quiet)
    work = layouts.Labelling(settings, overlay)
    context.exit(batch.run_jobs(planned, out, work, method, options))
