"""Errors that users see.

RoadtorchError
├── InputError      an image, map or folder that cannot be used
│   └── UnwritableError  a file or folder that cannot be written
├── ConfigError     a wrong setting, name or option
├── DatasetError    a data set that is incomplete or malformed
│   └── UnscorableError  one without labels of road
└── WeightsError    a weight file that is damaged or foreign
"""

import difflib
import math
import os
from collections.abc import Iterable
from enum import IntEnum

from roadtorch.base.bounded import strip_password

MAX_MESSAGE_LENGTH = 400
"""Longest location or problem of an error, in characters: it may repeat a file's content."""


class ExitCode(IntEnum):
    """Exit codes of the command line other than 0, success."""

    SOME_FAILED = 1
    WRONG_USAGE = 2
    INTERRUPTED = 130  # as shells report SIGINT (Ctrl-C)
    TERMINATED = 143  # and SIGTERM


class RoadtorchError(Exception):
    """A mistake that the user can fix: where it is, what is wrong, what to do.

    Its text is ``where: problem (hint)``; the command line prints it after
    ``roadtorch: error:`` and nothing else.

        >>> from roadtorch import RoadtorchError, load_detector
        >>> try:
        ...     load_detector("prior:rows", threshold=2)
        ... except RoadtorchError as error:
        ...     print(error.where, "|", error.problem)
        threshold | 2 was given

    Args:
        where: the file, setting or option; a path stays whole, other text longer than
            ``MAX_MESSAGE_LENGTH`` loses its middle; URLs lose their passwords.
        problem: what is wrong with it, shortened likewise.
        hint: what to do.
    """

    exit_code = ExitCode.WRONG_USAGE

    def __init__(self, where: object, problem: str, hint: str) -> None:
        location = strip_password(str(where))
        self.where = location if isinstance(where, os.PathLike) else truncate_middle(location)
        self.problem = truncate_middle(strip_password(problem))
        self.hint = hint
        super().__init__(f"{self.where}: {self.problem} ({hint})")

    def __reduce__(self) -> tuple[type["RoadtorchError"], tuple[str, str, str]]:
        """Pickle by the three arguments, so that the error crosses process boundaries."""
        return type(self), (self.where, self.problem, self.hint)


def truncate_middle(text: str, max_length: int = MAX_MESSAGE_LENGTH) -> str:
    """Return text of at most ``max_length`` characters, its middle replaced by an ellipsis."""
    half = (max_length - 1) // 2
    return text if len(text) <= max_length else f"{text[:half]}…{text[-half:]}"


class InputError(RoadtorchError):
    """An image, map or folder that cannot be used."""


class UnwritableError(InputError):
    """A file or folder that cannot be written, for lack of room or permission."""


class ConfigError(RoadtorchError):
    """A wrong setting, name or option."""


class DatasetError(RoadtorchError):
    """A data set that is incomplete or malformed."""


class UnscorableError(DatasetError):
    """A readable data set without labels of road."""

    exit_code = ExitCode.SOME_FAILED


class DivergedError(ConfigError):
    """A training whose loss is no longer finite, which leaves no weights."""

    exit_code = ExitCode.SOME_FAILED


class WeightsError(RoadtorchError):
    """A weight file that is damaged or foreign."""


def check_unit_range(where: object, low: float, high: float, hint: str) -> None:
    """Raise InputError unless values lie in [0, 1]; their bounds are NaN if one of them is."""
    if not (low >= 0 and high <= 1):
        problem = "holds NaN" if math.isnan(low) else f"has values from {low:g} to {high:g}"
        raise InputError(where, problem, hint)


def is_out_of_memory(error: Exception) -> bool:
    """Return whether Python, NumPy, torch, OpenCV or the dynamic linker lacked memory."""
    messages = (
        "allocate memory",
        "out of memory",
        "Insufficient memory",
        "bad_alloc",
        "bad allocation",
        "failed to map segment",
    )
    return isinstance(error, MemoryError) or any(text in str(error) for text in messages)


def to_input_error(where: object, error: Exception) -> InputError:
    """Return the InputError for any exception at the image or frame called ``where``.

    ``where`` replaces the name ``image`` in errors of detectors, which do not know the file.
    """
    if isinstance(error, RoadtorchError):
        location = where if error.where == "image" else error.where
        return InputError(location, error.problem, error.hint)
    if is_out_of_memory(error):
        problem = "needs more memory than is available"
        return InputError(where, problem, "give smaller images, or fewer --jobs")
    return InputError(where, f"{type(error).__name__}: {error}", "report it")


def unknown_name_error(
    kind: str, name: str, choices: Iterable[str], groups: Iterable[str] | None = None
) -> ConfigError:
    """Return the ConfigError for a misspelt name, with the nearest choices as its hint.

    If none is near, the hint lists all choices; or ``groups``, if there are too many.
    """
    choices = sorted(choices)
    near = difflib.get_close_matches(name, choices, n=3, cutoff=0.5)
    listed = choices if groups is None else sorted(groups)
    hint = f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(listed)}"
    return ConfigError(name, f"unknown {kind}", hint)
