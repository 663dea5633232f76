"""Options that several commands share, written once."""

import functools
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.completion import suggest_datasets, suggest_detectors, suggest_files

if TYPE_CHECKING:
    from roadtorch.base.settings import Settings
    from roadtorch.camera.camera import Camera
    from roadtorch.data.dataset import Dataset
    from roadtorch.detectors.detector import Detector
    from roadtorch.inputs.find import Inputs
    from roadtorch.run.run import RunOptions
    from roadtorch.run.workers import Workers

PATH = click.Path(path_type=Path)
Command = Callable[..., Any]

# --- what a user may say ------------------------------------------------------------------

DEFAULT_DETECTOR = "fusion"


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


@dataclass(frozen=True)
class FrameSelection:
    """Which frames and pictures of the inputs are looked at.

    every, start, end, limit: see ``roadtorch.inputs.item.Selection``. topic: of bags. patience:
    seconds within which a stream has to answer.
    """

    every: int
    start: float
    end: float | None
    limit: int | None
    topic: str | None
    patience: float

    def inputs(self, inputs: tuple[str, ...], out: Path) -> "Inputs":
        """The pictures and sources that inputs and options choose, but those of ``out``.

        Raises as ``find_inputs`` and ``Selection.of_pictures`` do.
        """
        from roadtorch.inputs.find import SourceOptions, find_inputs
        from roadtorch.inputs.item import Selection
        from roadtorch.inputs.live import Patience

        chosen = Selection(self.every, self.start, self.end, self.limit)
        options = SourceOptions(out, Patience(answer=self.patience), self.topic)
        found = find_inputs(inputs, chosen, options)
        return found._replace(pictures=chosen.of_pictures(found.pictures))


@dataclass(frozen=True)
class ComputeOptions:
    """With what the pictures of a run are worked on.

    jobs: pictures at a time on this machine; None for one a processor. engine: ``local`` or
    ``ray``. address: of a Ray cluster; None for one of this machine. workers: actors. threads: of
    torch and OpenCV within a picture. device: of torch. fail_fast: end at the first failure.
    """

    jobs: int | None
    engine: str
    address: str | None
    workers: int
    threads: int
    device: str
    fail_fast: bool

    @contextmanager
    def started(self, count: int | None) -> "Iterator[Workers]":
        """Who works on so many pictures (None: nobody knows), for the block.

        Raises ConfigError where Ray is not there, or ``--address`` is given without it.
        """
        from roadtorch.base.errors import ConfigError
        from roadtorch.run.workers import workers_for

        if self.engine == "local":
            if self.address is not None:
                remedy = "add --engine ray, or leave it out"
                raise ConfigError("--address", "is for Ray alone", remedy)
            yield workers_for(self.jobs, count, self.device)
            return
        from roadtorch.run.ray_workers import ray_workers

        with ray_workers(self.workers, self.address, self.device) as workers:
            yield workers


@dataclass(frozen=True)
class RunChoice:
    """How a run goes: processes (None for one a processor), redo what is done, no progress."""

    jobs: int | None = None
    overwrite: bool = False
    quiet: bool = False

    @property
    def options(self) -> "RunOptions":
        """The same for the run."""
        from roadtorch.run.run import RunOptions

        return RunOptions(self.overwrite, self.quiet)


# --- options ------------------------------------------------------------------------------

SECTIONS = {
    **dict.fromkeys((*DetectorOptions.__dataclass_fields__, "camera", "threshold"), "Detector"),
    **dict.fromkeys((*FrameSelection.__dataclass_fields__, "steady", "view"), "Footage"),
    **dict.fromkeys(ComputeOptions.__dataclass_fields__, "Computing"),
    **dict.fromkeys(("reports", "exported", "to", "imported", "origin"), "Without the page"),
}
"""The section of ``--help`` in which an option stands."""


class ConfigFile(click.ParamType):
    """A TOML file, or the name of a config that is shipped."""

    name = "path"

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
FOOTAGE = click.argument(
    "footage", metavar="FOOTAGE...", nargs=-1, required=True, shell_complete=suggest_files
)
CAMERA = click.option(
    "--camera", type=PATH, help="What roadtorch camera wrote about the camera of the pictures."
)
JOBS = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    help="Parallel processes; results do not depend on it. [one for each processor]",
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
            options = kind(**{field: given.pop(field) for field in fields})
            return command(*arguments, **{name: options}, **given)

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
        shell_complete=suggest_files,
        help="TOML file with the detector and its settings, or a shipped one's name.",
    ),
)
"""A command gets the options of ``DetectorOptions`` as ``choice``."""

with_run = _gathered(RunChoice, "run", JOBS, OVERWRITE, QUIET)
"""A command gets these as ``run``."""

with_compute = _gathered(
    ComputeOptions,
    "compute",
    JOBS,
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
    jobs: int | None

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
    """Return the command as it was typed, quoted for a shell."""
    return shlex.join(["roadtorch", *context.obj])
