"""roadtorch label: write machine labels of the scene layout."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import INPUTS_ARGUMENT, PATH, SETTING_OPTION, run_options

if TYPE_CHECKING:
    from roadtorch.run.plan import RunOptions


@click.command()
@INPUTS_ARGUMENT
@click.option("--out", type=PATH, required=True, help="Folder for the labels.")
@SETTING_OPTION
@run_options
@click.pass_context
def label_command(
    context: click.Context,
    inputs: tuple[str, ...],
    out: Path,
    assignments: tuple[str, ...],
    options: "RunOptions",
) -> None:
    """Label every pixel as sky (0), vertical (1), horizontal (2) or unlabelled (255).

    Each image gives NAME.png in the folder --out. Neither weights nor labels are needed.
    """
    from roadtorch.base.settings import build_settings, parse_assignments, to_toml
    from roadtorch.inputs.find import Inputs
    from roadtorch.inputs.images import find_images
    from roadtorch.layout.labeller import LabellerSettings
    from roadtorch.run.loop import Task
    from roadtorch.run.memo import cache_key
    from roadtorch.run.plan import plan_run
    from roadtorch.run.run import open_run
    from roadtorch.run.workers import configure_threads
    from roadtorch.run.writers.labels import Labelling, LabelWriter

    configure_threads()
    settings = build_settings(LabellerSettings, parse_assignments(assignments))
    labels = LabelWriter(out)
    todo = plan_run(Inputs(find_images(inputs, out), []), out, labels.suffixes)
    effective = to_toml("labeller", settings)
    run = context.with_resource(open_run(out, effective, todo, options))
    task = Task(Labelling(settings), labels, cache_key(settings), ("labels",))
    context.exit(run.process_images(todo.images, task))
