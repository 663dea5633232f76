"""Options that several commands share, written once."""

import functools
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.completion import (
    suggest_datasets,
    suggest_detector_configs,
    suggest_detectors,
    suggest_files,
    suggest_settings,
    suggest_splits,
)
from roadtorch.runs.options import ComputeOptions, DetectorOptions, FrameSelection, RunOptions

if TYPE_CHECKING:
    from roadtorch.data.dataset import Dataset

PATH = click.Path(path_type=Path)
Command = Callable[..., Any]

SECTIONS = {
    **dict.fromkeys((*DetectorOptions.__dataclass_fields__, "camera", "threshold"), "Detector"),
    **dict.fromkeys((*FrameSelection.__dataclass_fields__, "steady", "gif"), "Footage"),
    **dict.fromkeys(ComputeOptions.__dataclass_fields__, "Computing"),
    **dict.fromkeys(
        ("reports", "exported", "to", "imported", "origin", "user"), "Without the page"
    ),
}
"""The section of ``--help`` in which an option stands."""


class ConfigFile(click.ParamType):
    """A TOML file, or the name of a config that is shipped."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The file; ConfigError for a name that is neither."""
        from roadtorch.runtime.shipped_configs import config_file

        return config_file(str(value))


SETTING = click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    shell_complete=suggest_settings,
    help="One setting.",
)
FOOTAGE = click.argument(
    "footage", metavar="FOOTAGE...", nargs=-1, required=True, shell_complete=suggest_files
)
CAMERA = click.option(
    "--camera", type=PATH, help="What roadtorch camera wrote about the camera of the pictures."
)
JOBS = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    default=1,
    help="Pictures at a time; the results do not depend on it.",
)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Redo pictures that are done.")
QUIET = click.option("--quiet", is_flag=True, help="No progress, only failures.")


class Sectioned(click.Command):
    """A command whose ``--help`` has its options in sections.

    Those of its own stand first; what is gathered for a kind of ``SECTIONS`` has one of its own.
    """

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, section by section."""
        rows: dict[str, list[tuple[str, str]]] = {"Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record and isinstance(parameter, click.Option):
                rows.setdefault(SECTIONS.get(parameter.name or "", "Options"), []).append(record)
        for section, records in rows.items():
            with formatter.section(section):
                formatter.write_dl(records)


def _gathered(
    kind: type[Any], name: str, *options: Callable[..., Any]
) -> Callable[[Command], Command]:
    """What gives a command options that it gets as one argument ``name``, an object of a kind."""

    def decorated(command: Command) -> Command:
        @functools.wraps(command)
        def gathered(*arguments: Any, **given: Any) -> Any:
            fields = kind.__dataclass_fields__.keys() & given.keys()
            one = kind(**{field: given.pop(field) for field in fields})
            return command(*arguments, **{name: one}, **given)

        for option in reversed(options):
            gathered = option(gathered)
        return gathered

    return decorated


with_detector = _gathered(
    DetectorOptions,
    "choice",
    click.option(
        "--detector",
        shell_complete=suggest_detectors,
        help="Name of the detector; see roadtorch detectors. [fusion]",
    ),
    SETTING,
    click.option(
        "--config",
        type=ConfigFile(),
        shell_complete=suggest_detector_configs,
        help="TOML file with the detector and its settings, or a shipped one's name.",
    ),
)
"""A command gets the options of ``DetectorOptions`` as ``choice``."""

with_run = _gathered(RunOptions, "options", JOBS, OVERWRITE, QUIET)
"""A command gets these as ``options``."""

with_compute = _gathered(
    ComputeOptions,
    "compute",
    click.option(
        "--jobs",
        type=click.IntRange(min=1),
        help="Pictures at a time; the results do not depend on it. [one a processor]",
    ),
    click.option(
        "--engine",
        type=click.Choice(["local", "ray"]),
        default="local",
        help="Processes of this machine, or actors on Ray (extra: ray).",
    ),
    click.option("--address", help="Address of a Ray cluster; without it one is started here."),
    click.option(
        "--workers",
        type=click.IntRange(min=1),
        default=2,
        help="Actors on Ray, each with one processor.",
    ),
    click.option(
        "--threads",
        type=click.IntRange(min=1),
        default=1,
        help="Threads within a picture; likelihoods differ in the seventh digit.",
    ),
    click.option("--device", default="cpu", help="Device of the tensors: cpu, cuda, cuda:1."),
    click.option("--fail-fast", is_flag=True, help="End at the first picture that fails."),
)
"""A command gets the options of ``ComputeOptions`` as ``compute``."""

with_frames = _gathered(
    FrameSelection,
    "frames",
    click.option(
        "--every",
        type=click.IntRange(min=1),
        default=1,
        show_default=False,
        help="Look at one frame in this many.",
    ),
    click.option(
        "--start",
        type=click.FloatRange(min=0),
        default=0.0,
        show_default=False,
        help="Where to begin in footage, in seconds.",
    ),
    click.option(
        "--end",
        type=click.FloatRange(min=0),
        help="Where to end in footage, in seconds; that frame is left out.",
    ),
    click.option(
        "--limit", type=click.IntRange(min=1), help="At most this many frames or pictures."
    ),
    click.option("--topic", help="Image topic, where a bag has several."),
    click.option(
        "--patience",
        type=click.FloatRange(min=0.1),
        default=10.0,
        help="Seconds within which a stream has to answer.",
    ),
)
"""A command gets the options of ``FrameSelection`` as ``frames``."""


@dataclass(frozen=True)
class LabelledOptions:
    """Which detectors are looked at on which labelled pictures; see the options."""

    dataset: str
    root: Path
    split: str | None
    names: tuple[str, ...]
    assignments: tuple[str, ...]
    left_out: tuple[str, ...]
    limit: int | None
    jobs: int

    def opened(self) -> "Dataset":
        """The labelled set; DatasetError for one that is not there."""
        from roadtorch.data.catalogue import open_dataset
        from roadtorch.data.dataset import leave_out

        return leave_out(open_dataset(self.dataset, self.root, self.split), self.left_out)


with_labelled = _gathered(
    LabelledOptions,
    "labelled",
    click.argument("dataset", shell_complete=suggest_datasets),
    click.argument("root", type=PATH),
    click.option(
        "--split",
        shell_complete=suggest_splits,
        help="Part of the data set; camvid: dev (default), train, val, test.",
    ),
    click.option(
        "--detector",
        "names",
        multiple=True,
        default=("fusion",),
        shell_complete=suggest_detectors,
        help="Detector; may be given several times, with wildcards ('cpf*').",
    ),
    click.option(
        "--set",
        "assignments",
        multiple=True,
        shell_complete=suggest_settings,
        help="Setting of the detectors: key=value.",
    ),
    click.option(
        "--leave-out",
        "left_out",
        multiple=True,
        metavar="GROUP",
        help="Score this group, but leave it out of means and choices.",
    ),
    click.option("--limit", type=click.IntRange(min=1), help="Look at this many pictures only."),
    JOBS,
)
"""A command gets DATASET, ROOT and the options of ``LabelledOptions`` as ``labelled``."""


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
