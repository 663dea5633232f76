"""URLs: of the web by urllib; of fsspec ``s3://bucket/drive``, ``zip://INSIDE::ARCHIVE``."""

import base64
import re
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from http.client import HTTPException
from tempfile import TemporaryFile
from typing import IO, Any
from urllib.error import HTTPError
from urllib.parse import unquote
from urllib.request import Request, urlopen

from roadtorch.base.bounded import MAX_BYTES
from roadtorch.base.errors import ConfigError, InputError, unknown_name

WEB = ("http", "https")

ANSWER = 10.0
"""Seconds that a server of the web may be silent; ours: as ``Patience`` has it."""

CHUNK = 2**20  # bytes that are fetched at once


def scheme_of(given: str) -> str:
    """The scheme of a URL, or of the first of a chain (``zip://…::s3://…``); empty for a path."""
    scheme = re.match(r"([A-Za-z][A-Za-z0-9+._-]+)(://|::)", given)
    return scheme[1].lower() if scheme else ""


def is_url(given: str) -> bool:
    """Whether a text is a URL, not a path."""
    return scheme_of(given) != ""


def without_password(url: str) -> str:
    """An address for messages and files: without the name and password of a user."""
    return re.sub(r"(?<=://)[^/@]*@", "", url)


@contextmanager
def url_errors(url: str) -> Iterator[None]:
    """What goes wrong within the block in words that name the URL.

    Raises ConfigError where a package is missing for such URLs, else InputError.
    """
    try:
        yield
    except ImportError as problem:
        what = f"cannot be reached: {' '.join(str(problem).split())}"
        raise ConfigError(url, what, "install that package") from None
    except FileNotFoundError:
        raise InputError(url, "does not exist", "check the name") from None
    except (OSError, ValueError) as problem:
        what = f"cannot be used: {' '.join(str(problem).split()) or type(problem).__name__}"
        raise InputError(url, what, "check the URL and the access to it") from None


def file_system(url: str) -> tuple[Any, str]:
    """The file system of fsspec behind a URL or path, and the path in it.

    Raises ConfigError for a URL of no known kind, with near ones, and where fsspec or the package
    for such URLs is not installed.
    """
    with url_errors(url):
        from fsspec import available_protocols
        from fsspec.core import url_to_fs

        if (scheme := scheme_of(url)) and scheme not in available_protocols():
            raise unknown_name("kind of URL", scheme, available_protocols())
        return url_to_fs(url)


def url_bytes(url: str) -> bytes:
    """The bytes of the file behind a URL or path, at most 1 GiB.

    Raises InputError naming it when they cannot be had.
    """
    if scheme_of(url) in WEB:
        with fetched(url) as file:
            return file.read()
    system, path = file_system(url)
    with url_errors(url):
        data = system.cat_file(path, end=MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise too_large(url)
    return data


# --- the web ----------------------------------------------------------------------------


@contextmanager
def answer(url: str) -> Iterator[Any]:
    """A server's answer, after redirections: its headers, and its body to read.

    Raises InputError for one that does not come, comes late, or is no success.
    """
    address = without_password(url)
    headers = {"User-Agent": "roadtorch"}
    if (user := re.match(r"\w+://([^/@]*)@", url)) is not None:  # basic access, RFC 7617
        told = base64.b64encode(unquote(user[1]).encode()).decode()
        headers["Authorization"] = f"Basic {told}"
    try:
        with closing(urlopen(Request(address, headers=headers), timeout=ANSWER)) as response:
            yield response
    except HTTPError as problem:
        problem.close()
        what = f"is answered with {problem.code} {problem.reason}"
        raise InputError(address, what, "check the address") from None
    except (OSError, HTTPException, ValueError) as problem:
        cause = getattr(problem, "reason", problem)
        late = isinstance(cause, TimeoutError)
        what = f"{ANSWER:g} seconds without an answer" if late else str(cause) or "no answer"
        raise InputError(address, f"cannot be fetched: {what}", "check the address") from None


def fetched(url: str) -> IO[bytes]:
    """The body of an answer as a file without a name, at its start, at most 1 GiB.

    InputError as for ``answer``, for more, and for one that is cut.
    """
    with ExitStack() as stack, answer(url) as response:
        file = stack.enter_context(TemporaryFile())
        while data := response.read(CHUNK):
            if file.write(data) and file.tell() > MAX_BYTES:
                raise too_large(url)
        length = response.headers.get("Content-Length", "")
        if length.isdigit() and file.tell() < int(length):
            raise ValueError(f"it is cut after {file.tell():,} of {int(length):,} bytes")
        file.seek(0)
        stack.pop_all()  # whoever asked for the file closes it
    return file


def too_large(url: str) -> InputError:
    """The error for a file of more than ``MAX_BYTES``."""
    what = f"has more than {MAX_BYTES:,} bytes"
    return InputError(without_password(url), what, "make it smaller")
