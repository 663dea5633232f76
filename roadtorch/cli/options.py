"""Options that several commands share."""

import functools
import importlib
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    from roadtorch.camera.camera import Camera
    from roadtorch.detectors.detector import Detector


class FilePath(click.Path):
    """The path of a file or folder; an empty one, such as of an unset variable, is refused."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        return super().convert(value, param, ctx) if value else self.fail("it is empty", param, ctx)


PATH = FilePath(path_type=Path)
Command = Callable[..., Any]

# --- detector ---------------------------------------------------------------------------

DEFAULT_DETECTOR = "fusion"
RUN_OPTIONS_CLASS = "roadtorch.run.plan:RunOptions"


@dataclass(frozen=True)
class DetectorOptions:
    """A detector by name, with assignments ``KEY=VALUE``, a TOML file of settings and a runtime."""

    detector: str | None = None
    assignments: tuple[str, ...] = ()
    config: Path | None = None
    runtime: str = "torch"

    def name_and_values(self, threshold: float | None = None) -> tuple[str, dict[str, Any]]:
        """Return the detector's name and the values of its settings.

        Assignments override the file, and ``threshold`` overrides both. The file may name the
        detector under ``detector``. Raises ConfigError for wrong assignments or a wrong file.
        """
        from roadtorch.base.errors import ConfigError
        from roadtorch.base.settings import merge, parse_assignments, read_settings_file

        values = read_settings_file(self.config) if self.config else {}
        name = values.pop("detector", DEFAULT_DETECTOR)
        if not isinstance(name, str):
            raise ConfigError("detector", f"{name!r} was given", "give a name in quotes")
        values = merge(values, parse_assignments(self.assignments))
        if threshold is not None:
            values["threshold"] = threshold
        return name if self.detector is None else self.detector, values

    def split(self, group: str) -> "tuple[DetectorOptions, Any]":
        """Return the options without the assignments to a group, and what they assign to it."""
        from roadtorch.base.settings import parse_assignments

        parts = [item for item in self.assignments if re.match(rf"\s*{group}\b", item)]
        remaining = tuple(item for item in self.assignments if item not in parts)
        return replace(self, assignments=remaining), parse_assignments(parts).get(group, {})

    def load(
        self,
        camera_file: Path | None = None,
        threshold: float | None = None,
        device: str | None = None,
    ) -> "tuple[Detector, Camera | None]":
        """Return the detector, with settings for the camera of a file, and that camera."""
        from roadtorch.camera.camera import Camera
        from roadtorch.detectors.catalogue import detector_entry, load_detector

        name, values = self.name_and_values(threshold)
        detector_entry(name).make_settings(values)  # raises for a key that load_detector takes
        camera = None if camera_file is None else Camera.read(camera_file)
        options = {"camera": camera, "device": device, "runtime": self.runtime}
        return load_detector(name, **options, **values), camera


# --- shell completion -------------------------------------------------------------------

# Each function is a ``shell_complete`` of click.


def suggest_detectors(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Suggest detectors, without those of a grid of hundreds (see ``roadtorch detectors``)."""
    from roadtorch.detectors.catalogue import list_detectors

    return [name for name in list_detectors("*") if name.startswith(incomplete)]


def suggest_candidates(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[str] | list[CompletionItem]:
    """Suggest detectors, or else files: weights, configs, folders of maps."""
    detectors = suggest_detectors(context, parameter, incomplete)
    return detectors or [CompletionItem(incomplete, type="file")]


def suggest_datasets(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Suggest labelled data sets."""
    from roadtorch.data.catalogue import DATASET_FORMATS

    return [name for name in sorted(DATASET_FORMATS) if name.startswith(incomplete)]


# --- options ------------------------------------------------------------------------------

FOOTAGE_KINDS = ("overlay-frames", "mask-video", "likelihood-video", "bag")
"""Results of footage alone, for ``--save``."""

OPTION_SECTIONS = {
    **dict.fromkeys(("detector", "assignments", "config", "camera_file", "threshold"), "Detector"),
    **dict.fromkeys(("every", "start", "end", "limit", "topic"), "Footage"),
    **dict.fromkeys(("smoothing", "view"), "Footage"),
    **dict.fromkeys(("jobs", "device", "runtime"), "Computing"),
    **dict.fromkeys(("reports", "exported", "to", "imported", "origin"), "Without the page"),
}
"""Sections of ``--help``, by option."""


class ConfigFile(click.Path):
    """A TOML file, or the name of a shipped config."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of the file; raise ConfigError for any other name."""
        from roadtorch.base.settings import find_config

        return find_config(str(value))


SETTING_OPTION = click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a setting; may be repeated.",
)
RUNTIME_OPTION = click.option(
    "--runtime", default="torch", help="Library for the network: torch, onnxruntime (extra: onnx)."
)
INPUTS_ARGUMENT = click.argument(
    "inputs", metavar="INPUT...", nargs=-1, required=True, type=click.Path()
)
FOOTAGE_ARGUMENT = click.argument(
    "footage", metavar="FOOTAGE...", nargs=-1, required=True, type=click.Path()
)
CAMERA_OPTION = click.option(
    "--camera",
    "camera_file",
    type=PATH,
    help="Camera file that roadtorch camera wrote from its footage.",
)
JOBS_OPTION = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    help="Parallel processes; results do not depend on their number. [one for each processor]",
)
OVERWRITE_OPTION = click.option(
    "--overwrite", is_flag=True, help="Process images again that are done."
)
ROAD_OPTION = click.option(
    "--road",
    multiple=True,
    metavar="VALUE",
    help="Value (7, #ff0000) or COCO category of masks that is road; may be repeated. "
    "[1, 255 or road]",
)
VOID_OPTION = click.option(
    "--void",
    multiple=True,
    metavar="VALUE",
    help="Value or COCO category of masks that does not count; may be repeated.",
)
QUIET_OPTION = click.option("--quiet", is_flag=True, help="Print only failures, no progress.")


# --- options without effect ---------------------------------------------------------------

MODES = "without --report --export --import"
PAGE = ("--detector", "--set", "--config", "--runtime")
SCORING = "--split --against --bev --conditions --leave-out --mean-from --threshold-from --limit"
FOOTAGE = ("--smoothing", "--view", *(f"--save {kind}" for kind in FOOTAGE_KINDS))

OPTION_CONDITIONS: Mapping[str, Mapping[str, str]] = {
    "annotate": dict.fromkeys(PAGE, MODES)
    | {"--to": "with --export", "--from": "with --import"}
    | {"--export": "without --report", "--import": "without --report --export"},
    "evaluate": dict.fromkeys((*SCORING.split(), "--road", "--void"), "without --submit")
    | dict.fromkeys(("--montage", "--tune"), "with --out without --submit")
    | {"--submit": "with --out"},
    "export": {"--mask": "with onnx"},
    "infer": dict.fromkeys(FOOTAGE, "with footage")
    | {"--topic": "with bag", "--depth": "with likelihood", "--set grid": "with grid"},
    "train": dict.fromkeys(("--road", "--void"), "with --masks")
    | {"--corrected-images": "with --corrections"},
}
"""What options need, by command: other options, or facts about the inputs that commands state."""


def refuse_unused(context: click.Context, **facts: bool) -> None:
    """Raise ConfigError for an option that other options, or these facts, leave without effect."""
    from roadtorch.base.errors import ConfigError

    states = dict(facts)
    for option in [item for item in context.command.params if isinstance(item, click.Option)]:
        name, values = option.opts[0], context.params.get(option.name or "")
        source = context.get_parameter_source(option.name or "")
        states[name] = source is ParameterSource.COMMANDLINE
        for value in values if states[name] and isinstance(values, tuple) else ():
            key = str(value).partition("=")[0].strip()
            states[f"{name} {key}"] = states[f"{name} {key.partition('.')[0]}"] = True
    for option, condition in OPTION_CONDITIONS.get(context.command.name or "", {}).items():
        word = ""
        for part in condition.split() if states.get(option) else ():
            word = part if part in ("with", "without") else word
            if part in states and states[part] != (word == "with"):
                raise ConfigError(option, "has no effect", f"give it {word} {part}")


class CheckedCommand(click.Command):
    """A command that refuses options without effect."""

    def invoke(self, ctx: click.Context) -> Any:
        """Check the options, and run."""
        refuse_unused(ctx)
        return super().invoke(ctx)


class SectionedCommand(CheckedCommand):
    """A command whose ``--help`` groups its options by ``OPTION_SECTIONS``, others first."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, section by section."""
        rows: dict[str, list[tuple[str, str]]] = {"Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record and isinstance(parameter, click.Option):
                rows.setdefault(OPTION_SECTIONS.get(parameter.name or "", "Options"), []).append(
                    record
                )
        for section, records in rows.items():
            with formatter.section(section):
                formatter.write_dl(records)


def _group_options(
    group_class: str, name: str, *options: Callable[..., Any]
) -> Callable[[Command], Command]:
    """Return a decorator that adds options to a command, passed as one argument ``name``.

    group_class: its dataclass as ``module:class``, so that ``--help`` need not import it.
    """

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def wrapped(*arguments: Any, **values: Any) -> Any:
            module, _, attribute = group_class.partition(":")
            group = getattr(importlib.import_module(module), attribute)
            fields = {key: values.pop(key) for key in group.__dataclass_fields__.keys() & values}
            return command(*arguments, **{name: group(**fields)}, **values)

        for option in reversed(options):
            wrapped = option(wrapped)
        return wrapped

    return decorate


detector_options = _group_options(
    "roadtorch.cli.options:DetectorOptions",
    "choice",
    click.option(
        "--detector",
        shell_complete=suggest_detectors,
        help="Name of the detector; see roadtorch detectors. [fusion]",
    ),
    SETTING_OPTION,
    click.option(
        "--config",
        type=ConfigFile(),
        help="TOML file with the detector and its settings, or the name of a shipped one.",
    ),
    RUNTIME_OPTION,
)
"""Options of ``DetectorOptions``, passed as ``choice``."""

THREADS_OPTION = click.option(
    "--threads", type=click.IntRange(min=1), help="Threads of torch; the result depends on it."
)

run_options = _group_options(
    RUN_OPTIONS_CLASS, "options", JOBS_OPTION, OVERWRITE_OPTION, QUIET_OPTION
)
"""Options of ``RunOptions`` for commands without those of computing, passed as ``options``."""

computing_options = _group_options(
    RUN_OPTIONS_CLASS,
    "options",
    JOBS_OPTION,
    click.option("--device", default="cpu", help="torch device: cpu, cuda, cuda:1."),
    OVERWRITE_OPTION,
    QUIET_OPTION,
)
"""All options of ``RunOptions``, passed as ``options``."""

selection_options = _group_options(
    "roadtorch.inputs.item:Selection",
    "selection",
    click.option(
        "--every",
        type=click.IntRange(min=1),
        default=1,
        show_default=False,
        help="Process every Nth frame.",
    ),
    click.option(
        "--start",
        type=click.FloatRange(min=0),
        default=0.0,
        show_default=False,
        help="Start of the footage to process, in seconds.",
    ),
    click.option(
        "--end",
        type=click.FloatRange(min=0),
        help="End of the footage to process, in seconds, exclusive.",
    ),
    click.option(
        "--limit", type=click.IntRange(min=1), help="Process at most this many images or frames."
    ),
    click.option("--topic", help="Image topic, if a bag has several."),
)
"""Options of ``Selection``, passed as ``selection``."""


def command_line(context: click.Context) -> str:
    """Return the command line as it was typed, quoted for a shell, without passwords of URLs."""
    from roadtorch.base.bounded import strip_password

    return shlex.join(["roadtorch", *map(strip_password, context.obj)])
