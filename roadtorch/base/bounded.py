"""What comes from outside: files of bounded size, names in any encoding, foreign documents."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import pydantic
from pydantic import Field

from roadtorch.base.errors import DatasetError, RoadtorchError, shortened

MAX_BYTES = 2**30
"""Of one file; ours: a picture of 100 megapixels, 16 bits, uncompressed, has 800 million."""


def read_regular(path: str | os.PathLike[str], most: int = MAX_BYTES) -> bytes:
    """The bytes of a regular file of at most ``most`` bytes; OSError as ``regular_size`` has it."""
    size = regular_size(path, most)
    with Path(path).open("rb") as file:
        data = file.read(size + 1)
        if len(data) <= most:
            data += file.read(most + 1 - len(data))  # it grew
    if len(data) > most:
        raise _too_large(most)
    return data


def regular_size(path: str | os.PathLike[str], most: int = MAX_BYTES) -> int:
    """The bytes of a regular file of at most ``most`` bytes, counted, for those who map it.

    A pipe would keep the reader waiting, and a device may have no end. Raises OSError, with the
    reason as its ``strerror``: for what is missing or may not be read, a folder, a pipe, a
    device, a socket, and a file that is larger.
    """
    status = Path(path).stat()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(0, "it is a folder")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(0, "it is a pipe or a device, not a file")
    if status.st_size > most:
        raise _too_large(most)
    return status.st_size


def _too_large(most: int) -> OSError:
    return OSError(0, f"it has more than {most:,} bytes")


def reason(problem: Exception) -> str:
    """Why something could not be read, on one line.

    Foreign bytes make decoders raise anything: IndexError, struct.error, cv2.error, …
    """
    words = problem.strerror if isinstance(problem, OSError) else None
    lines = (words or str(problem)).strip().splitlines()
    return lines[0] if lines else "it is damaged"


def printable(text: str) -> str:
    r"""The text with every byte of a name that is not UTF-8 as ``\xff``, so that it can be written.

    Python reads such bytes of a name as lone surrogates, which no encoding takes; where the
    system's encoding is ASCII, every other letter comes as such too, and comes back here.
    """
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # a surrogate that stands for no byte
        return text.encode("utf-8", "backslashreplace").decode("utf-8")


# --- documents of other programs and of browsers ----------------------------------------

# A model bounds every number and list, so that nothing is allocated for what a file merely claims;
# JSON goes from its bytes straight into the model.

MAX_DOCUMENT_BYTES = 2**28  # of one file; ours: a COCO file of a thousand images has as many

MAX_SIDE = 2**20  # pixels, as of an image that is read

SHOWN = 60  # letters of a wrong value that a refusal repeats

Side = Annotated[int, Field(ge=1, le=MAX_SIDE)]
Coordinate = Annotated[float, Field(ge=-4 * MAX_SIDE, le=4 * MAX_SIDE)]


class ForeignDocument(pydantic.BaseModel):
    """A part of a document of another program: the keys that are read; others are passed over."""

    model_config = pydantic.ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


def first_mistake(problem: pydantic.ValidationError) -> str:
    """Describe the first mistake: where in the document, what should be there, what is there."""
    error = problem.errors(include_url=False)[0]
    if error["type"] == "json_invalid":
        return f"it is not JSON: {error['msg'].removeprefix('Invalid JSON: ')}"
    place = ".".join(str(part) for part in error["loc"]) or "it"
    if error["type"] == "missing":
        return f"{place} is missing"
    message = error["msg"].removeprefix("Value error, ")
    value = shortened(repr(error["input"]), SHOWN)
    return f"{place}: {message[0].lower()}{message[1:]}, {value} was given"


@contextmanager
def read_document(path: Path, remedy: str) -> Iterator[bytes]:
    """Yield the bytes of a file to a block that reads a document from them.

    What goes wrong in the block with files, numbers and memory becomes a DatasetError that names
    the file; errors of ours go through.
    """
    try:
        yield read_regular(path, MAX_DOCUMENT_BYTES)
    except RoadtorchError:
        raise
    except pydantic.ValidationError as problem:
        raise DatasetError(path, f"cannot be read: {first_mistake(problem)}", remedy) from None
    except MemoryError:
        raise DatasetError(path, "is more than there is memory for", remedy) from None
    except (OSError, ValueError, LookupError, ArithmeticError, RecursionError) as problem:
        raise DatasetError(path, f"cannot be read: {reason(problem)}", remedy) from None
