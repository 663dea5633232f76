"""Bounded reads of files, and printable text of names, URLs and exceptions."""

import os
import re
import stat
from pathlib import Path

MAX_BYTES = 2**30
"""Largest file that is read; ours: 100 megapixels of 16 bits, uncompressed, have 800 million."""

USER_PATTERN = r"(?<=\w\w:/)(/?)([^/?#\n]*|[^/?#@:\[\n]*:(?!\d*(?:[/?#]|$))\S*)@"
"""User and password in a URL: up to the last @ of its host's part, or up to the last @ of all
where / ? or # of an unencoded password would cut that part at what is no port."""

SECRET_PATTERN = (
    r"(?i)([?&;/_](?:user|usr|login|[\w-]*(?:pass|pw|token|secret|key|auth|sig|credential)[\w-]*)=)"
    r"[^&;#\s]*?(?=[&;#\s]|_[a-z]+=|$)"
)
"""Value of a URL's parameter that is secret by its name."""


def read_regular(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> bytes:
    """Return the bytes of a regular file; raise OSError as ``regular_file_size`` does."""
    size = regular_file_size(path, max_bytes)
    with Path(path).open("rb") as file:
        data = file.read(size + 1)
        if len(data) <= max_bytes:
            data += file.read(max_bytes + 1 - len(data))  # it grew
    if len(data) > max_bytes:
        raise _too_large(max_bytes)
    return data


def regular_file_size(path: str | os.PathLike[str], max_bytes: int = MAX_BYTES) -> int:
    """Return the size of a regular file in bytes, for readers that map it.

    Raises OSError, with the reason as its ``strerror``, for a file that is missing, unreadable or
    larger than ``max_bytes``, for a folder, and for a pipe, socket or device: reading a pipe may
    block, and a device may have no end.
    """
    status = Path(path).stat()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(0, "it is a folder")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(0, "it is a pipe or a device, not a file")
    if status.st_size > max_bytes:
        raise _too_large(max_bytes)
    return status.st_size


def _too_large(max_bytes: int) -> OSError:
    return OSError(0, f"it has more than {max_bytes:,} bytes")


def reason(error: Exception) -> str:
    """Return the message of an exception, on one line; "it is damaged" if it has none.

    For decoders, which raise anything on damaged bytes: IndexError, struct.error, cv2.error, …
    """
    message = error.strerror if isinstance(error, OSError) else None
    lines = (message or str(error)).strip().splitlines()
    return lines[0] if lines else "it is damaged"


def to_printable(text: str) -> str:
    r"""Return text that can be encoded, with bytes of names that are not UTF-8 as ``\xff``.

    Python reads such bytes as lone surrogates, which no encoding takes. If the system's encoding is
    ASCII, it reads all other letters as surrogates too; they are restored here.
    """
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # a surrogate that stands for no byte
        return text.encode("utf-8", "backslashreplace").decode("utf-8")


def from_printable(text: str) -> str:
    """Return the name of a file that ``to_printable`` made text of, if its bytes are not UTF-8."""
    return re.sub(r"\\x([89a-f][0-9a-f])", lambda match: chr(0xDC00 + int(match[1], 16)), text)


def plural(count: float, noun: str) -> str:
    """Return a number with its noun: "1 click", "2 clicks"."""
    return f"{count:g} {noun}{'s' * (count != 1)}"


def strip_user(url: str) -> str:
    """Return a URL without user name and password."""
    return re.sub(USER_PATTERN, r"\1", url)


def strip_password(text: str) -> str:
    """Return a URL, or text with URLs, without their secrets, for messages and files."""
    if ":/" not in text:
        return text
    bare = re.sub(rf"{USER_PATTERN}(?:[^\s?#]*@)?", r"\1", text)  # its password may have @ and /
    return re.sub(r"\w\w://\S+", lambda url: re.sub(SECRET_PATTERN, r"\1***", url[0]), bare)
