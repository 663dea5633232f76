"""Addresses: their kinds, and what servers of the web answer."""

import base64
import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.client import HTTPException
from typing import Any
from urllib.error import HTTPError
from urllib.parse import unquote
from urllib.request import Request, urlopen

from roadtorch.base.bounded import MAX_BYTES
from roadtorch.base.errors import InputError

WEB = ("http", "https")

ANSWER = 10.0
"""Seconds that a server of the web may be silent; ours: as ``Patience`` has it."""

CHUNK = 2**20  # bytes that are fetched at once


def scheme_of(given: str) -> str:
    """Return the scheme of an address; empty for a path."""
    scheme = re.match(r"([A-Za-z][A-Za-z0-9+._-]+)://", given)
    return scheme[1].lower() if scheme else ""


def without_password(url: str) -> str:
    """Return an address for messages and files: without the name and password of a user."""
    return re.sub(r"(?<=://)[^/@]*@", "", url)


def slug(url: str) -> str:
    """Return a name for results: what stands between the signs of an address, no password."""
    address = re.sub(r"^\w+://|[?#].*", "", without_password(url))
    return re.sub(r"[^\w.]+", "-", address).strip("-.") or "stream"


@contextmanager
def answer(url: str) -> Iterator[Any]:
    """Yield a server's answer, after redirections: its headers, and its body to read.

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
    except HTTPError as error:
        error.close()
        problem = f"is answered with {error.code} {error.reason}"
        raise InputError(address, problem, "check the address") from None
    except (OSError, HTTPException, ValueError) as error:
        cause = getattr(error, "reason", error)
        late = isinstance(cause, TimeoutError)
        problem = f"{ANSWER:g} seconds without an answer" if late else str(cause) or "no answer"
        raise InputError(address, f"cannot be fetched: {problem}", "check the address") from None


def url_bytes(url: str) -> bytes:
    """Fetch the body of an answer, at most 1 GiB.

    Raises InputError as ``answer``, for more, for one that is cut, and for what is not of the web.
    """
    if scheme_of(url) not in WEB:
        raise InputError(url, "is not of the web", "give http:// or https://, or a file")
    data = bytearray()
    with answer(url) as response:
        while chunk := response.read(CHUNK):
            data += chunk
            if len(data) > MAX_BYTES:
                problem = f"has more than {MAX_BYTES:,} bytes"
                raise InputError(without_password(url), problem, "make it smaller")
        length = response.headers.get("Content-Length", "")
        if length.isdigit() and len(data) < int(length):
            raise ValueError(f"it is cut after {len(data):,} of {int(length):,} bytes")
    return bytes(data)
