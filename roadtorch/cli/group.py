"""The ``roadtorch`` command: sub-commands loaded on use, mistakes told in one line."""

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

from roadtorch.base.errors import ExitCode, RoadtorchError, fault, lacks_memory
from roadtorch.base.signals import Terminated, interruption_first, terminated_in_words
from roadtorch.base.version import __version__

# name: (module:attribute, summary). The summary is here so that help imports no command.
COMMANDS = {
    "adapt": ("roadtorch.cli.adapt:adapt", "Fine-tune the network on footage, without labels."),
    "annotate": ("roadtorch.cli.annotate:annotate", "Correct machine labels in a page."),
    "camera": ("roadtorch.cli.camera:camera", "Find ego car and horizon in a camera's footage."),
    "detectors": ("roadtorch.cli.detectors:detectors", "List the detectors, or explain one."),
    "doctor": ("roadtorch.cli.doctor:doctor", "Check this installation."),
    "evaluate": ("roadtorch.cli.evaluate:evaluate", "Score detectors on labelled images."),
    "export": ("roadtorch.cli.export:export", "Export a network: ONNX, a web page."),
    "grid": ("roadtorch.cli.grid:grid", "Map the road in images onto the ground, in metres."),
    "infer": ("roadtorch.cli.infer:infer", "Find the road in images."),
    "label": ("roadtorch.cli.label:label", "Label images as sky, vertical and horizontal."),
    "ros": ("roadtorch.cli.ros:ros", "Run a node of ROS 2 that finds the road."),
    "train": ("roadtorch.cli.train:train", "Train a layout network on unlabelled images."),
}

ELSEWHERE = {
    **dict.fromkeys(("predict", "segment", "detect", "run", "mask"), "infer"),
    **dict.fromkeys(("finetune", "fine-tune", "learn"), "adapt"),
    **dict.fromkeys(("score", "test", "eval", "benchmark", "val"), "evaluate"),
    **dict.fromkeys(("calibrate", "ego"), "camera"),
}
"""What other programs call our commands."""

ALLOCATIONS = 50_000
"""New objects after which Python looks for circles, of its own 700; ours: ten images' worth.

What a command loads (torch alone: 166 thousand objects) stays until its end. To look through it
again and again while it is loaded, and once more at the end, takes a third of the time of a command
on one image."""

BRIEF_WAITS = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "20000"}
"""Threads of OpenMP that wait spin for about a millisecond, then sleep, unless somebody has said
how they wait. By default they spin fifteen times as long: beside other work on the same cores a
step of training on two threads then takes three times as long."""


class CommandGroup(click.Group):
    """A click group that imports a command when it is used and reports our errors."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of all commands."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command; None when there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        if not any(parameter.name == "debug" for parameter in command.params):
            command.params.append(_debug_option())
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the first argument names; misspelt, the nearest ones are told."""
        if args[0] not in COMMANDS and not (ctx.resilient_parsing or args[0].startswith("-")):
            near = get_close_matches(args[0], COMMANDS, n=3, cutoff=0.5)
            near = [ELSEWHERE[args[0]]] if args[0] in ELSEWHERE else near
            hint = f"did you mean {', '.join(near)}?" if near else "see roadtorch --help"
            raise _Mistake(f"{args[0]}: no such command ({hint})")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of commands in ``--help``, from the table alone."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in sorted(COMMANDS)])

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; mistakes and crashes become one line, unless ``--debug`` asks."""
        try:
            return super().invoke(ctx)
        except RoadtorchError as error:
            _trace(ctx)
            mistake = _Mistake(str(error))
            mistake.exit_code = error.exit_code
            raise mistake from None
        except (click.ClickException, click.exceptions.Exit, click.Abort, OSError):
            raise  # OSError: a closed pipe, which click ends quietly
        except Exception as error:
            _trace(ctx)
            if lacks_memory(error):
                raise click.ClickException(str(fault(ctx.invoked_subcommand, error))) from None
            problem = f"a fault of roadtorch: {type(error).__name__}: {error}"
            raise click.ClickException(
                f"{ctx.invoked_subcommand}: {problem} (report it with --debug)"
            ) from None

    def main(self, args: Sequence[str] | None = None, *_: Any, **extra: Any) -> NoReturn:
        """Run with the given arguments or those of the process, and exit with its code."""
        args = sys.argv[1:] if args is None else list(args)
        extra |= {"prog_name": "roadtorch", "standalone_mode": False, "obj": args}
        try:
            with terminated_in_words(), interruption_first():
                _settle_process()
                code = super().main(args, **extra)
        except (click.Abort, KeyboardInterrupt) as error:
            click.echo("roadtorch: interrupted; what was finished is kept", err=True)
            cause = error.__cause__ or error  # click makes an Abort of KeyboardInterrupt
            code = ExitCode.TERMINATED if isinstance(cause, Terminated) else ExitCode.INTERRUPTED
        except click.exceptions.NoArgsIsHelpError as error:
            error.show()
            code = ExitCode.WRONG_USAGE
        except click.ClickException as error:
            click.echo(f"roadtorch: error: {_one_line(error)}", err=True)
            code = error.exit_code
        except OSError as error:
            click.echo(f"roadtorch: error: {error}", err=True)
            code = ExitCode.SOME_FAILED
        sys.exit(code if isinstance(code, int) else 0)


class _Mistake(click.ClickException):
    """A mistake that is already told as ``where: what (remedy)``."""

    exit_code: int = ExitCode.WRONG_USAGE


def _one_line(error: click.ClickException) -> str:
    """``where: what (remedy)`` for click's own mistakes."""
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


def _trace(ctx: click.Context) -> None:
    if ctx.meta.get("roadtorch.debug"):
        traceback.print_exc()


def _debug_option() -> click.Option:
    def remember(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value:
            ctx.meta["roadtorch.debug"] = True  # meta is shared by a command and its group

    return click.Option(
        ["--debug"],
        is_flag=True,
        expose_value=False,
        callback=remember,
        help="Show the traceback of an error.",
    )


def _settle_process() -> None:
    """Warnings in our words, any name tellable, streams that are open, brief waits, seldom gc."""

    def show_warning(message: Warning | str, *_: Any) -> None:
        click.echo(f"roadtorch: warning: {message}", err=True)

    warnings.showwarning = show_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names in any encoding can be told
            stream.reconfigure(errors="backslashreplace")
    if isinstance(sys.stdin, io.TextIOWrapper):  # and read
        sys.stdin.reconfigure(errors="surrogateescape")
    if not any(name in os.environ for name in (*BRIEF_WAITS, "KMP_BLOCKTIME")):
        os.environ.update(BRIEF_WAITS)  # read by OpenMP when torch is loaded
    # Python started anew for a worker takes no types.py beside the user's images for its own.
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    gc.set_threshold(ALLOCATIONS)
    atexit.register(gc.freeze)
    open_streams()


def open_streams() -> None:
    """Send what is written to a closed stdout or stderr nowhere, and read nothing from stdin.

    Where one is closed (``2>&-``) Python has None in its place, and the next file that is
    opened gets its number: libraries would write their messages into an image.
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
    params=[_debug_option()],
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.version_option(__version__, message="roadtorch %(version)s")
def main() -> None:
    """Find the road in images, without labels, on a CPU.

    roadtorch infer IMAGES makes maps of how road-like each pixel is.
    """
