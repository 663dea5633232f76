"""Options that several commands share, written once."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

PATH = click.Path(path_type=Path)
Command = Callable[..., Any]

LABELLED_SET = (
    click.argument("dataset"),
    click.argument("root", type=PATH),
    click.option("--split", help="Part of the data set; camvid: dev (default), train, val."),
    click.option(
        "--detector",
        "names",
        multiple=True,
        default=("fusion",),
        show_default=True,
        help="Detector; may be given several times, with wildcards ('cpf*').",
    ),
    click.option(
        "--set", "assignments", multiple=True, help="Setting of the detectors: key=value."
    ),
    click.option("--limit", type=click.IntRange(min=1), help="Look at this many pictures only."),
    click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True),
)


def labelled_set(command: Command) -> Command:
    """Detectors over a labelled set: DATASET ROOT --split --detector --set --limit --jobs."""
    for option in reversed(LABELLED_SET):
        command = option(command)
    return command
