"""URLs: their schemes, and responses of web servers."""

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

WEB_SCHEMES = ("http", "https")

RESPONSE_TIMEOUT = 10.0  # seconds that a web server may be silent; ours: as for a live stream
READ_SIZE = 2**20  # bytes


def url_scheme(address: str) -> str:
    """Return the scheme of a URL; "" for a path."""
    scheme = re.match(r"([A-Za-z][A-Za-z0-9+._-]+)://", address)
    return scheme[1].lower() if scheme else ""


def strip_password(url: str) -> str:
    """Return a URL without user name and password, for messages and files."""
    return re.sub(r"(?<=://)[^/@]*@", "", url)


def slug(url: str) -> str:
    """Return a file name for the results of a URL: its words, without password and query."""
    address = re.sub(r"^\w+://|[?#].*", "", strip_password(url))
    return re.sub(r"[^\w.]+", "-", address).strip("-.") or "stream"


@contextmanager
def open_url(url: str) -> Iterator[Any]:
    """Yield the response to a GET request, after redirections; InputError if there is none."""
    address = strip_password(url)
    headers = {"User-Agent": "roadtorch"}
    if (user := re.match(r"\w+://([^/@]*)@", url)) is not None:  # basic access, RFC 7617
        credentials = base64.b64encode(unquote(user[1]).encode()).decode()
        headers["Authorization"] = f"Basic {credentials}"
    try:
        request = Request(address, headers=headers)
        with closing(urlopen(request, timeout=RESPONSE_TIMEOUT)) as response:
            yield response
    except HTTPError as error:
        error.close()
        problem = f"returned {error.code} {error.reason}"
        raise InputError(address, problem, "check the address") from None
    except (OSError, HTTPException, ValueError) as error:
        cause = getattr(error, "reason", error)
        text = str(cause) or "no response"
        if isinstance(cause, TimeoutError):
            text = f"{RESPONSE_TIMEOUT:g} seconds without a response"
        raise InputError(address, f"cannot be fetched: {text}", "check the address") from None


def read_url(url: str) -> bytes:
    """Fetch the body of a response; InputError if there is none, or it has more than 1 GiB."""
    if url_scheme(url) not in WEB_SCHEMES:
        raise InputError(url, "is no web address", "give http:// or https://, or a file")
    data = bytearray()
    with open_url(url) as response:
        while chunk := response.read(READ_SIZE):
            data += chunk
            if len(data) > MAX_BYTES:
                problem = f"has more than {MAX_BYTES:,} bytes"
                raise InputError(strip_password(url), problem, "make it smaller")
        length = response.headers.get("Content-Length", "")
        if length.isdigit() and len(data) < int(length):
            raise ValueError(f"it is truncated after {len(data):,} of {int(length):,} bytes")
    return bytes(data)
