"""Options that several commands share, written once."""

import functools
import importlib
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    from roadtorch.base.settings import Settings
    from roadtorch.camera.camera import Camera
    from roadtorch.detectors.detector import Detector

PATH = click.Path(path_type=Path)
Command = Callable[..., Any]

# --- what a user may say ------------------------------------------------------------------

DEFAULT_DETECTOR = "fusion"
RUN_OPTIONS = "roadtorch.run.plan:RunOptions"


@dataclass(frozen=True)
class DetectorOptions:
    """Which detector, and its settings.

    detector: its name. assignments: KEY=VALUE each. config: a TOML file.
    """

    detector: str | None = None
    assignments: tuple[str, ...] = ()
    config: Path | None = None

    def named(self, threshold: float | None = None) -> tuple[str, dict[str, Any]]:
        """The detector's name and the values of its settings.

        The file's values yield to the assignments, and those to ``threshold``. The file may name
        the detector under ``detector``. Raises ConfigError for what is no setting or no file.
        """
        from roadtorch.base.errors import ConfigError
        from roadtorch.base.settings import merge, parse_assignments, read_settings_file

        values = read_settings_file(self.config) if self.config else {}
        named = values.pop("detector", DEFAULT_DETECTOR)
        if not isinstance(named, str):
            raise ConfigError("detector", f"{named!r} was given", "give a name in quotes")
        values = merge(values, parse_assignments(self.assignments))
        if threshold is not None:
            values["threshold"] = threshold
        return self.detector or named, values

    def loaded(
        self, camera: Path | None = None, threshold: float | None = None
    ) -> "tuple[Detector, Camera | None]":
        """The detector, and the camera that a file describes, which its settings then know.

        Raises what ``named``, ``Camera.read`` and ``load_detector`` raise.
        """
        from roadtorch.camera.camera import Camera
        from roadtorch.detectors.catalogue import load_detector

        name, values = self.named(threshold)
        known = None if camera is None else Camera.read(camera)
        return load_detector(name, camera=known, **values), known


def as_toml(detector: str, settings: "Settings") -> str:
    """A file for ``--config`` that gives this detector with these settings."""
    from roadtorch.base.settings import to_toml

    return to_toml(detector, settings).removesuffix("\n")


# --- what a shell is told could come next ---------------------------------------------------

# Each function is a ``shell_complete`` of click, which knows of no detectors, data sets and files.


def suggest_detectors(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Detectors; those of a grid of hundreds are left to ``roadtorch detectors``."""
    from roadtorch.detectors.catalogue import list_detectors

    return [name for name in list_detectors("*") if name.startswith(incomplete)]


def suggest_candidates(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[str] | list[CompletionItem]:
    """Detectors, or else weight files, configs and folders of maps."""
    detectors = suggest_detectors(context, parameter, incomplete)
    return detectors or [CompletionItem(incomplete, type="file")]


def suggest_datasets(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Labelled sets."""
    from roadtorch.data.catalogue import list_datasets

    return [name for name in list_datasets() if name.startswith(incomplete)]


# --- options ------------------------------------------------------------------------------

SECTIONS = {
    **dict.fromkeys(("detector", "assignments", "config", "camera", "threshold"), "Detector"),
    **dict.fromkeys(("every", "start", "end", "limit", "topic"), "Footage"),
    **dict.fromkeys(("steady", "view"), "Footage"),
    **dict.fromkeys(("jobs", "engine", "threads", "device"), "Computing"),
    **dict.fromkeys(("reports", "exported", "to", "imported", "origin"), "Without the page"),
}
"""The section of ``--help`` in which an option stands."""


class ConfigFile(click.Path):
    """A TOML file, or the name of a config that is shipped."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The file; ConfigError for a name that is neither."""
        from roadtorch.base.settings import config_file

        return config_file(str(value))


SETTING = click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="One setting.",
)
INPUTS = click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=click.Path())
FOOTAGE = click.argument(
    "footage", metavar="FOOTAGE...", nargs=-1, required=True, type=click.Path()
)
CAMERA = click.option(
    "--camera", type=PATH, help="What roadtorch camera wrote about the camera of the images."
)
JOBS = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    help="Parallel processes; results do not depend on it. [one for each processor]",
)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Redo images that are done.")
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


def _gathered(kind: str, name: str, *options: Callable[..., Any]) -> Callable[[Command], Command]:
    """Give a command options that it gets as one argument ``name``.

    kind: its dataclass as ``module:class``, so that ``--help`` need not import it.
    """

    def decorated(command: Command) -> Command:
        @functools.wraps(command)
        def gathered(*arguments: Any, **values: Any) -> Any:
            module, _, attribute = kind.partition(":")
            made = getattr(importlib.import_module(module), attribute)
            own = {field: values.pop(field) for field in made.__dataclass_fields__.keys() & values}
            return command(*arguments, **{name: made(**own)}, **values)

        for option in reversed(options):
            gathered = option(gathered)
        return gathered

    return decorated


with_detector = _gathered(
    "roadtorch.cli.options:DetectorOptions",
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
        help="TOML file with the detector and its settings, or a shipped one's name.",
    ),
)
"""A command gets the options of ``DetectorOptions`` as ``choice``."""

with_run = _gathered(RUN_OPTIONS, "run", JOBS, OVERWRITE, QUIET)
"""A command gets the options of a ``RunOptions`` as ``run``."""

with_computing = _gathered(
    RUN_OPTIONS,
    "run",
    JOBS,
    click.option(
        "--engine",
        default="local",
        help="local: processes; ray: actors on Ray (extra: ray), or the address of its cluster.",
    ),
    click.option(
        "--threads",
        type=click.IntRange(min=1),
        default=1,
        help="Threads within an image; likelihoods differ in the seventh digit.",
    ),
    click.option("--device", default="cpu", help="Device of the tensors: cpu, cuda, cuda:1."),
    OVERWRITE,
    QUIET,
)
"""A command gets all options of a ``RunOptions`` as ``run``."""

with_selection = _gathered(
    "roadtorch.inputs.item:Selection",
    "selection",
    click.option(
        "--every",
        type=click.IntRange(min=1),
        default=1,
        show_default=False,
        help="Take one frame in this many.",
    ),
    click.option(
        "--start",
        type=click.FloatRange(min=0),
        default=0.0,
        show_default=False,
        help="Where to start in footage, in seconds.",
    ),
    click.option(
        "--end",
        type=click.FloatRange(min=0),
        help="Where to end in footage, in seconds; that frame is left out.",
    ),
    click.option("--limit", type=click.IntRange(min=1), help="At most this many frames or images."),
    click.option("--topic", help="Image topic, where a bag has several."),
)
"""A command gets the options of a ``Selection`` as ``selection``."""


def command_line(context: click.Context) -> str:
    """Return the command as it was typed, quoted for a shell."""
    return shlex.join(["roadtorch", *context.obj])
