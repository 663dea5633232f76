"""URLs of fsspec: ``s3://bucket/drive``, ``https://…``, ``zip://INSIDE::ARCHIVE``."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from roadtorch.errors import ConfigError, InputError, unknown_name
from roadtorch.io.bounded import MAX_BYTES


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
    system, path = file_system(url)
    with url_errors(url):
        data = system.cat_file(path, end=MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(url, f"has more than {MAX_BYTES:,} bytes", "make it smaller")
    return data
