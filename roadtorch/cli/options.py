"""Options that several commands share, written once."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

PATH = click.Path(path_type=Path)
Command = Callable[..., Any]

ONE_DETECTOR = click.option(
    "--detector", help="Name of the detector; see roadtorch detectors. [fusion]"
)
SETTING = click.option(
    "--set", "assignments", multiple=True, metavar="KEY=VALUE", help="One setting."
)
CONFIG = click.option("--config", type=PATH, help="TOML file with the detector and its settings.")
CAMERA = click.option(
    "--camera", type=PATH, help="What roadtorch camera wrote about the camera of the pictures."
)
JOBS = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Pictures at a time; the results do not depend on it.",
)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Redo pictures that are done.")
QUIET = click.option("--quiet", is_flag=True, help="No progress, only failures.")

LABELLED_SET = (
    click.argument("dataset"),
    click.argument("root", type=PATH),
    click.option("--split", help="Part of the data set; camvid: dev (default), train, val, test."),
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
    click.option(
        "--leave-out",
        "left_out",
        multiple=True,
        metavar="GROUP",
        help="Score a drive or folder, but count it in no mean and no choice.",
    ),
    click.option("--limit", type=click.IntRange(min=1), help="Look at this many pictures only."),
    JOBS,
)

FRAMES = (
    click.option("--every", type=click.IntRange(min=1), default=1, help="One frame of so many."),
    click.option("--start", type=click.FloatRange(min=0), default=0.0, help="Of footage: seconds."),
    click.option("--end", type=click.FloatRange(min=0), help="Of footage: seconds, left out."),
    click.option("--limit", type=click.IntRange(min=1), help="At most so many frames or pictures."),
    click.option("--topic", help="Of bags: the images to look at, where there are several."),
    click.option(
        "--patience",
        type=click.FloatRange(min=0.1),
        default=10.0,
        show_default=True,
        help="Seconds within which a stream has to answer.",
    ),
)


def labelled_set(command: Command) -> Command:
    """Detectors over a labelled set: DATASET ROOT and what ``LABELLED_SET`` has beside them."""
    return _with(LABELLED_SET, command)


def chosen_frames(command: Command) -> Command:
    """Which frames of footage are looked at: the options of ``FRAMES``."""
    return _with(FRAMES, command)


def _with(options: Sequence[Callable[[Command], Command]], command: Command) -> Command:
    for option in reversed(options):
        command = option(command)
    return command
