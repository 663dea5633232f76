"""What comes from outside: files of bounded size, names in any encoding."""

import os
import stat
from pathlib import Path

MAX_BYTES = 2**30
"""Of one file; ours: an image of 100 megapixels, 16 bits, uncompressed, has 800 million."""


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


def reason(error: Exception) -> str:
    """Why something could not be read, on one line.

    Foreign bytes make decoders raise anything: IndexError, struct.error, cv2.error, …
    """
    words = error.strerror if isinstance(error, OSError) else None
    lines = (words or str(error)).strip().splitlines()
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
