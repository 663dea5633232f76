"""The ``roadtorch`` command: subcommands imported on use, errors in one line."""

import atexit
import gc
import importlib
import io
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, NoReturn

import click

from roadtorch.base.bounded import strip_password
from roadtorch.base.errors import ExitCode, RoadtorchError, is_out_of_memory, to_input_error
from roadtorch.base.signals import SigtermInterrupt, prefer_interruption, raise_on_sigterm
from roadtorch.base.version import __version__

# name: (module:attribute, summary). The summary is here so that help imports no command.
COMMANDS = {
    "adapt": ("roadtorch.cli.adapt:adapt_command", "Fine-tune fusion on unlabelled footage."),
    "annotate": ("roadtorch.cli.annotate:annotate_command", "Correct machine labels in a page."),
    "camera": ("roadtorch.cli.camera:camera_command", "Estimate a camera's ego car and horizon."),
    "detectors": ("roadtorch.cli.detectors:detectors_command", "List detectors and settings."),
    "doctor": ("roadtorch.cli.doctor:doctor_command", "Check this installation."),
    "evaluate": ("roadtorch.cli.evaluate:evaluate_command", "Score detectors on labelled images."),
    "export": ("roadtorch.cli.export:export_command", "Export a network to ONNX or a web page."),
    "infer": ("roadtorch.cli.infer:infer_command", "Find the road in images and footage."),
    "label": ("roadtorch.cli.label:label_command", "Label sky, vertical and horizontal."),
    "ros": ("roadtorch.cli.ros:ros_command", "Run a ROS 2 node that finds the road."),
    "train": (
        "roadtorch.cli.train:train_command",
        "Train a network on unlabelled images, masks or corrections.",
    ),
}

INTERRUPT_MESSAGES = {
    **dict.fromkeys(("infer", "label"), "interrupted; finished results are kept"),
    **dict.fromkeys(("adapt", "train"), "interrupted; run the same command again to resume"),
    "annotate": "interrupted; corrections are saved",
    "ros": "node stopped",
}
"""Messages of commands on Ctrl-C or SIGTERM; of others, ``interrupted``."""

SYNONYMS = {
    **dict.fromkeys(("predict", "segment", "detect", "run", "mask"), "infer"),
    **dict.fromkeys(("finetune", "fine-tune", "learn"), "adapt"),
    **dict.fromkeys(("score", "test", "eval", "benchmark", "val"), "evaluate"),
    **dict.fromkeys(("calibrate", "ego"), "camera"),
    "images": "roadtorch infer images",
    "video": "roadtorch infer VIDEO",
    "grid": "roadtorch infer --save grid",
}
"""Names of other programs for our commands, to suggest ours."""

GC_THRESHOLD = 50_000
"""New objects between two runs of the garbage collector, instead of 700; ours: those of ten images.

What a command loads (torch alone: 166 thousand objects) stays until its end. Scanning it again and
again while it loads, and once more at the end, takes a third of the time of a command on one image.
"""

OPENMP_WAIT = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "20000"}
"""Variables with which waiting OpenMP threads spin for about a millisecond, then sleep. By default
they spin fifteen times as long: beside other work on the same cores a step of training on two
threads then takes three times as long."""


class CommandGroup(click.Group):
    """A click group that imports commands on use and reports errors in one line."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; return None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        return getattr(importlib.import_module(module), attribute)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of the first argument; suggest the nearest if it is misspelt."""
        if args[0] not in COMMANDS and not (ctx.resilient_parsing or args[0].startswith("-")):
            near = get_close_matches(args[0], COMMANDS, n=3, cutoff=0.5)
            near = [SYNONYMS[args[0]]] if args[0] in SYNONYMS else near
            hint = f"did you mean {', '.join(near)}?" if near else "see roadtorch --help"
            raise _OneLineError(f"{args[0]}: no such command ({hint})")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands in ``--help`` from COMMANDS, without imports."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in sorted(COMMANDS)])

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; errors and crashes become one line, with a traceback on ``--debug``."""
        try:
            return super().invoke(ctx)
        except RoadtorchError as error:
            _print_traceback(ctx)
            one_line = _OneLineError(str(error))
            one_line.exit_code = error.exit_code  # pyright: ignore[reportAttributeAccessIssue]
            raise one_line from None
        except (click.ClickException, click.exceptions.Exit, click.Abort, OSError):
            raise  # OSError: a closed pipe, on which click exits quietly
        except Exception as error:
            _print_traceback(ctx)
            if is_out_of_memory(error):
                error = to_input_error(ctx.invoked_subcommand, error)
                raise click.ClickException(str(error)) from None
            problem = f"a bug in roadtorch: {type(error).__name__}: {error}"
            message = f"{ctx.invoked_subcommand}: {problem} (report it with --debug)"
            raise click.ClickException(message) from None

    def main(self, args: Sequence[str] | None = None, *_: Any, **extra: Any) -> NoReturn:
        """Run with these arguments, or those of the process, and exit with the exit code."""
        args = sys.argv[1:] if args is None else list(args)
        extra |= {"prog_name": "roadtorch", "standalone_mode": False, "obj": args}
        try:
            with raise_on_sigterm(), prefer_interruption():
                _configure_process()
                code = super().main(_debug_first(args), **extra)
        except (click.Abort, KeyboardInterrupt) as error:
            name = next((word for word in args if not word.startswith("-")), "")
            click.echo(f"roadtorch: {INTERRUPT_MESSAGES.get(name, 'interrupted')}", err=True)
            cause = error.__cause__ or error  # click makes an Abort of KeyboardInterrupt
            is_sigterm = isinstance(cause, SigtermInterrupt)
            code = ExitCode.TERMINATED if is_sigterm else ExitCode.INTERRUPTED
        except click.exceptions.NoArgsIsHelpError as error:
            error.show()
            code = ExitCode.WRONG_USAGE
        except click.ClickException as error:
            click.echo(f"roadtorch: error: {strip_password(_one_line(error))}", err=True)
            code = error.exit_code
        except OSError as error:
            click.echo(f"roadtorch: error: {strip_password(str(error))}", err=True)
            code = ExitCode.SOME_FAILED
        sys.exit(code if isinstance(code, int) else 0)


class _OneLineError(click.ClickException):
    """An error whose message is already ``where: problem (hint)``."""

    exit_code = int(ExitCode.WRONG_USAGE)


def _one_line(error: click.ClickException) -> str:
    """Return ``where: problem (hint)`` for an error of click."""
    if isinstance(error, click.NoSuchOption):
        near = error.possibilities or []
        hint = f"did you mean {', '.join(near)}?" if near else _see_help(error)
        return f"{error.option_name}: no such option ({hint})"
    message = " ".join(error.format_message().split())
    if isinstance(error, click.UsageError):
        return f"{message.rstrip('.')} ({_see_help(error)})"
    return message


def _see_help(error: click.UsageError) -> str:
    return f"see {error.ctx.command_path if error.ctx else 'roadtorch'} --help"


def _print_traceback(ctx: click.Context) -> None:
    if ctx.params["debug"]:
        click.echo(strip_password(traceback.format_exc()), err=True)


def _debug_first(args: list[str]) -> list[str]:
    """Move ``--debug``, which may stand anywhere, to where the group takes it."""
    end = args.index("--") if "--" in args else len(args)
    return [*sorted(args[:end], key=lambda word: word != "--debug"), *args[end:]]


def _configure_process() -> None:
    """Configure warnings, encoding errors, OpenMP, the garbage collector and standard streams."""

    def show_warning(message: Warning | str, *_: object) -> None:
        click.echo(f"roadtorch: warning: {message}", err=True)

    warnings.showwarning = show_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names in any encoding can be printed
            stream.reconfigure(errors="backslashreplace")
    if isinstance(sys.stdin, io.TextIOWrapper):  # and read
        sys.stdin.reconfigure(errors="surrogateescape")
    if not any(name in os.environ for name in (*OPENMP_WAIT, "KMP_BLOCKTIME")):
        os.environ.update(OPENMP_WAIT)  # read by OpenMP when torch is loaded
    gc.set_threshold(GC_THRESHOLD)
    atexit.register(gc.freeze)
    open_streams()


def open_streams() -> None:
    """Connect closed standard streams (``2>&-``) to the null device.

    Python has None in place of a closed stream, and the next file to be opened gets its number:
    libraries would write their messages into an image.
    """
    handle = os.open(os.devnull, os.O_RDWR)
    while handle <= 2:
        os.set_inheritable(handle, True)
        handle = os.open(os.devnull, os.O_RDWR)
    os.close(handle)
    sys.stdin = sys.stdin or open(0, closefd=False)  # noqa: SIM115
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115


@click.group(
    cls=CommandGroup,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.version_option(__version__, message="roadtorch %(version)s")
@click.option("--debug", is_flag=True, help="Show the traceback of an error; anywhere on the line.")
def main(debug: bool) -> None:
    """Find the road in images, without labels, on a CPU.

    roadtorch infer IMAGES writes likelihoods, masks and overlays.
    """
