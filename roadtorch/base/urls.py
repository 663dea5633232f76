"""URLs: their schemes and secrets, and responses of web servers."""

import base64
import re
import string
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.client import HTTPException, HTTPMessage, HTTPResponse
from typing import IO
from urllib.error import HTTPError
from urllib.parse import quote, unquote, urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from roadtorch.base.bounded import MAX_BYTES, USER_PATTERN, strip_password, strip_user
from roadtorch.base.errors import InputError

WEB_SCHEMES = ("http", "https")

RESPONSE_TIMEOUT = 10.0  # seconds that a web server may be silent; ours: as for a live stream
READ_SIZE = 2**20  # bytes


def url_scheme(address: str) -> str:
    """Return the scheme of a URL; "" for a path."""
    scheme = re.match(r"([A-Za-z][A-Za-z0-9+._-]+)://", address)
    return scheme[1].lower() if scheme else ""


def slug(url: str) -> str:
    """Return a file name for the results of a URL: its words, without password and query."""
    address = re.sub(r"^\w+://|[?#].*", "", strip_password(url))
    return re.sub(r"[^\w.]+", "-", address).strip("-.") or "stream"


def encode_url(url: str) -> str:
    """Percent-encode what no request may contain: letters beyond ASCII, spaces, / in a password.

    Names of hosts become IDNA; what is encoded already stays.
    """
    user = re.search(USER_PATTERN, url)
    credentials = quote(user[2], safe=string.punctuation.translate(_RESERVED)) if user else ""
    parts = urlsplit(strip_user(url))
    host = parts.netloc if parts.netloc.isascii() else parts.netloc.encode("idna").decode()
    address = parts._replace(netloc=f"{credentials}@{host}" if user else host).geturl()
    return quote(address, safe=string.punctuation, errors="surrogateescape")


_RESERVED = str.maketrans("", "", "/?#@[]")


class _OwnCredentials(HTTPRedirectHandler):
    """Redirections, on which another origin (scheme, host, port) gets no credentials."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage, newurl: str
    ) -> Request | None:
        """Return the request to the new address."""
        target = encode_url(strip_user(newurl))
        request = super().redirect_request(req, fp, code, msg, headers, target)
        if request is not None and (request.type, request.host) != (req.type, req.host):
            request.remove_header("Authorization")
        return request


@contextmanager
def open_url(url: str) -> Iterator[HTTPResponse]:
    """Yield the response to a GET request, after redirections; InputError if there is none."""
    origin = strip_password(url)
    headers = {"User-Agent": "roadtorch"}
    try:
        if (user := re.search(USER_PATTERN, url)) is not None:  # basic access, RFC 7617
            credentials = base64.b64encode(unquote(user[2]).encode()).decode()
            headers["Authorization"] = f"Basic {credentials}"
        address = encode_url(strip_user(url))
        opener = build_opener(_OwnCredentials)
        with closing(opener.open(Request(address, None, headers), None, RESPONSE_TIMEOUT)) as body:
            yield body
    except HTTPError as error:
        error.close()
        problem = f"returned {error.code} {error.reason}"
        raise InputError(origin, problem, "check the address") from None
    except (OSError, HTTPException, ValueError) as error:
        cause = getattr(error, "reason", error)
        text = str(cause) or "no response"
        if isinstance(cause, TimeoutError):
            text = f"{RESPONSE_TIMEOUT:g} seconds without a response"
        raise InputError(origin, f"cannot be fetched: {text}", "check the address") from None


def read_url(url: str) -> bytes:
    """Fetch the body of a response; InputError if there is none, or it has more than 1 GiB."""
    if url_scheme(url) not in WEB_SCHEMES:
        raise InputError(url, "is no web address", "give http:// or https://, or a file")
    data = bytearray()
    with open_url(url) as response:
        for chunk in read_chunks(response):
            data += chunk
            if len(data) > MAX_BYTES:
                problem = f"has more than {MAX_BYTES:,} bytes"
                raise InputError(url, problem, "make it smaller")
    return bytes(data)


def read_chunks(response: HTTPResponse, size: int = READ_SIZE) -> Iterator[bytes]:
    """Yield the body of a response; ValueError where it is truncated, or packed unasked."""
    if (coding := response.headers.get("Content-Encoding", "identity")) != "identity":
        raise ValueError(f"it is packed by {coding}, which is not read")
    received, length = 0, response.headers.get("Content-Length", "")
    while chunk := response.read(size):
        received += len(chunk)
        yield chunk
    if length.isdigit() and received < int(length):
        raise ValueError(f"it is truncated after {received:,} of {int(length):,} bytes")
