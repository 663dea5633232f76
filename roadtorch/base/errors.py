"""The errors that users see.

RoadtorchError
├── InputError      an image, map or folder that cannot be used
│   └── UnwritableError  a file or folder that cannot be written
├── ConfigError     a setting, a name or an option that is wrong
├── DatasetError    a data set that is incomplete or not what it says
│   └── UnscorableError  one whose labels say nothing about road
└── WeightsError    a weight file that is damaged or foreign
"""

import difflib
import os
from collections.abc import Iterable
from enum import IntEnum

MAX_LETTERS = 400
"""Of what a refusal repeats of a file's content: a line that can be read, whatever is in there."""


class ExitCode(IntEnum):
    """What the command line ends with; 0 where all went well."""

    SOME_FAILED = 1
    WRONG_USAGE = 2
    INTERRUPTED = 130  # as shells say of SIGINT (Ctrl-C)
    TERMINATED = 143  # and of SIGTERM


class RoadtorchError(Exception):
    """A mistake that the user can mend: where it is, what is wrong, what to do.

    The text reads ``where: problem (hint)``; the command line prints it behind
    ``roadtorch: error:`` and nothing else. Where and problem lose their middle when they are
    longer than ``MAX_LETTERS``; paths are told whole.

        >>> from roadtorch import RoadtorchError, load_detector
        >>> try:
        ...     load_detector("prior:rows", threshold=2)
        ... except RoadtorchError as error:
        ...     print(error.where, "|", error.problem)
        threshold | 2 was given
    """

    exit_code = ExitCode.WRONG_USAGE

    def __init__(self, where: object, problem: str, hint: str) -> None:
        self.where = str(where) if isinstance(where, os.PathLike) else shortened(str(where))
        self.problem = shortened(problem)
        self.hint = hint
        super().__init__(f"{self.where}: {self.problem} ({hint})")

    def __reduce__(self) -> tuple[type["RoadtorchError"], tuple[str, str, str]]:
        """Three arguments again, so that the error survives a process boundary."""
        return type(self), (self.where, self.problem, self.hint)


def shortened(text: str, most: int = MAX_LETTERS) -> str:
    """A text of at most ``most`` letters, an ellipsis in the place of its middle."""
    half = (most - 1) // 2
    return text if len(text) <= most else f"{text[:half]}…{text[-half:]}"


class InputError(RoadtorchError):
    """An image, map or folder that cannot be used."""


class UnwritableError(InputError):
    """A file or folder that cannot be written, for want of room or of permission."""


class ConfigError(RoadtorchError):
    """A setting, a name or an option that is wrong."""


class DatasetError(RoadtorchError):
    """A data set that is incomplete or not what it says."""


class UnscorableError(DatasetError):
    """A data set that was read whole, and whose labels say nothing about road."""

    exit_code = ExitCode.SOME_FAILED


class WeightsError(RoadtorchError):
    """A weight file that is damaged or foreign."""


def lacks_memory(error: Exception) -> bool:
    """Whether it is of memory that was not there: Python's, NumPy's, torch's, OpenCV's words.

    The last are the linker's, where a library finds no room.
    """
    words = (
        "allocate memory",
        "out of memory",
        "Insufficient memory",
        "bad_alloc",
        "bad allocation",
        "failed to map segment",
    )
    return isinstance(error, MemoryError) or any(word in str(error) for word in words)


def fault(where: object, error: Exception) -> InputError:
    """What went wrong at an image or frame, for messages that name it.

    Detectors cannot know the file and speak of ``image``. What nobody foresaw is more memory than
    there is, or a fault of ours.
    """
    if isinstance(error, RoadtorchError):
        known = where if error.where == "image" else error.where
        return InputError(known, error.problem, error.hint)
    if lacks_memory(error):
        problem = "needs more memory than there is"
        return InputError(where, problem, "give smaller images, or fewer --jobs")
    return InputError(where, f"{type(error).__name__}: {error}", "report it")


def unknown_name(
    kind: str, name: str, known: Iterable[str], groups: Iterable[str] | None = None
) -> ConfigError:
    """The error for a misspelt name, with the nearest known ones in its remedy.

    Where none is near, all are told; or ``groups``, where they are too many.
    """
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    every = known if groups is None else sorted(groups)
    hint = f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(every)}"
    return ConfigError(name, f"unknown {kind}", hint)
