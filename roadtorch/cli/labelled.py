"""What ``evaluate`` and ``tune`` share: a pass over labelled pictures that somebody watches."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from roadtorch.data.dataset import Dataset
    from roadtorch.evaluation.result import Evaluation
    from roadtorch.evaluation.scoring import Scored


def watched(results: "Iterator[Scored]", done: int, total: int) -> "Iterator[Scored]":
    """The same results under a progress bar; KeyboardInterrupt after the one in hand."""
    from tqdm import tqdm

    from roadtorch.runtime.signals import stop_on_signals

    if done:
        click.echo(f"roadtorch: going on after {done} of {total} pictures", err=True)
    with stop_on_signals() as stop:
        for result in tqdm(results, initial=done, total=total, unit="image", disable=None):
            yield result
            stop.interrupt()


def camera_settings(path: Path | None, names: Sequence[str]) -> dict[str, Any]:
    """What a camera's file sets for all detectors of those names; nothing without a file.

    Raises as ``Camera.read`` and ``expand_names`` do.
    """
    from roadtorch.camera.camera import Camera
    from roadtorch.detector import DetectorSettings
    from roadtorch.detectors.catalogue import detector_entry
    from roadtorch.evaluation.methods import expand_names

    if path is None:
        return {}
    camera = Camera.read(path)
    kinds = [detector_entry(name).settings for name in expand_names(names)]
    for_all = [camera.settings_for(kind) for kind in kinds or [DetectorSettings]]
    return min(for_all, key=len)  # the ego car for each, the horizon where every one has it


def opened(name: str, root: Path, split: str | None, left_out: Sequence[str]) -> "Dataset":
    """The labelled set that a command is given, with the groups that it leaves out.

    Raises as ``open_dataset`` and ``leave_out`` do.
    """
    from roadtorch.data.catalogue import open_dataset
    from roadtorch.data.dataset import leave_out

    return leave_out(open_dataset(name, root, split), left_out)


def tell_failures(evaluation: "Evaluation") -> None:
    """One line on stderr for each picture that could not be scored."""
    for one in evaluation.failures:
        click.echo(f"failed: {one.image}: {one.reason}", err=True)


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
