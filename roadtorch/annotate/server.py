"""The web server of the correction page: address, access control, routes and limits.

It listens on the loopback interface only, but any page in a browser can send requests there, and a
foreign name can resolve to it (DNS rebinding). Therefore the Host header must name the loopback, an
Origin header must be that of this server, every request for data must carry the token, and the
Content-Security-Policy allows the page to load only from this server.
"""

import asyncio
import base64
import hashlib
import json
import mimetypes
import os
import secrets
import shlex
import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import pydantic
import uvicorn
from pydantic import Field
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from roadtorch.annotate.session import Session, compute_views
from roadtorch.base.atomic import atomic_write
from roadtorch.base.errors import RoadtorchError, UnwritableError
from roadtorch.base.image import jpeg_bytes, read_image, to_pixels
from roadtorch.base.settings import Settings
from roadtorch.data.events import parse_event
from roadtorch.imaging.resize import WorkingSize, resize_to_work

HOST = "127.0.0.1"  # the only interface to listen on
FIRST_PORT = 8765
ADDRESS_FILE = ".session.json"
PAGE_FOLDER = Path(__file__).with_name("static")
mimetypes.add_type("text/javascript", ".js")  # some Windows registries have another one

PAGE_IMAGE_SIZE = WorkingSize(pixels=1600 * 1200)
"""Largest size at which images are sent; strokes are in pixels of the full image."""

THUMBNAIL_SIZE = WorkingSize(pixels=112 * 84)

MAX_BODY = 2 * 2**20  # bytes of one event; ours: a long stroke has about ten thousand
MAX_DRAINED = 64 * 2**20  # bytes read of a body that is too long, so that the error arrives

TRAIN_COMMAND = (
    "roadtorch train --config corrections --images {} --corrections {} --out runs/corrected"
)
"""Command that trains on the corrections, shown once all images are confirmed."""

MAX_DECODING = 2  # images decoded at a time: each takes about ten times its bytes

RESPONSE_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


# --- access and limits ------------------------------------------------------------------


def error_response(status: int, where: str, problem: str, hint: str) -> JSONResponse:
    """Return an error as JSON, with the text that the page shows."""
    return JSONResponse({"error": f"{where}: {problem} ({hint})"}, status)


class AccessMiddleware:
    """Middleware that checks Origin and token, and adds ``RESPONSE_HEADERS``.

    A request that is cancelled when the server stops gets a 503 response.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on to the application."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        started = False

        async def send_with_headers(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                MutableHeaders(scope=message).update(RESPONSE_HEADERS)
            await send(message)

        try:
            app = self._check(Request(scope)) or self._app
            await app(scope, receive, send_with_headers)
        except asyncio.CancelledError:
            if not started:
                hint = "start roadtorch annotate again"
                response = error_response(503, "server", "was stopped", hint)
                await response(scope, receive, send_with_headers)

    def _check(self, request: Request) -> Response | None:
        """Return the error response to a forbidden request, None for an allowed one."""
        server = f"http://{request.headers.get('host', '')}"
        origin = request.headers.get("origin", server)
        if origin != server:
            return error_response(403, origin[:100], "is another site", "use this server's page")
        if request.url.path.startswith("/static/"):
            return None  # public code
        token = request.headers.get("x-token") or request.query_params.get("token", "")
        if secrets.compare_digest(token.encode(), self._token.encode()):
            return None
        hint = "open the address that roadtorch printed"
        return error_response(403, "token", "is missing or wrong", hint)


async def read_body(request: Request) -> bytes | None:
    """Read the body of a request; None where it is longer than ``MAX_BODY``."""
    body, length = bytearray(), 0
    async for chunk in request.stream():
        length += len(chunk)
        if length <= MAX_BODY:
            body += chunk
        if length > MAX_DRAINED:
            break
    return bytes(body) if length <= MAX_BODY else None


# --- routes -----------------------------------------------------------------------------


def make_app(session: Session, token: str) -> Starlette:
    """Build the web application of a session."""
    page = SessionApi(session)
    routes = [
        Route("/api/images", page.images),
        Route("/api/image", partial(page.jpeg, encode_image)),
        Route("/api/thumbnail", partial(page.jpeg, encode_thumbnail)),
        Route("/api/superpixels", page.superpixels),
        Route("/api/state", page.state),
        Route("/api/event", page.event, methods=["POST"]),
    ]
    handlers: dict[Any, Any] = {OSError: _handle_disk_error}
    handlers |= {kind: partial(_handle_error, status) for kind, status in ERROR_STATUSES.items()}
    return page_app("annotate.html", routes, token, handlers)


def page_app(page: str, routes: Sequence[BaseRoute], token: str, handlers: Any = None) -> Starlette:
    """Build a web application: a page, its static files and its API, behind access control."""
    html = Route("/", lambda _: FileResponse(PAGE_FOLDER / page))
    static = Mount("/static", StaticFiles(directory=PAGE_FOLDER))
    access = Middleware(AccessMiddleware, token=token)
    host = Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    routes = [html, static, *routes]
    return Starlette(routes=routes, middleware=[access, host], exception_handlers=handlers)


class SessionApi:
    """Request handlers of the page's API; images are identified by the parameter ``name``."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._decoding = asyncio.Semaphore(MAX_DECODING)

    def images(self, request: Request) -> Response:
        """Return the list of images; 204 where it has not changed since ``stamp``."""
        listing = self._session.listing()
        folders = map(shlex.quote, map(str, (self._session.images.root, self._session.out)))
        command = TRAIN_COMMAND.format(*folders)
        stamp = hashlib.sha256(json.dumps(listing).encode()).hexdigest()[:16]
        if request.query_params.get("stamp") == stamp:
            return Response(status_code=204)
        content = {"stamp": stamp, "folder": self._session.key, "images": listing}
        return JSONResponse({**content, "train_command": command})

    async def jpeg(self, encode: Callable[[Path, int], bytes], request: Request) -> Response:
        """Return an image as JPEG; ``encode`` takes its path and modification time."""

        def read() -> bytes:
            path = self._session.images.path(_parameter(request, "name"))
            return encode(path, path.stat().st_mtime_ns)

        async with self._decoding:  # waiting here leaves the thread pool free for strokes
            return Response(await run_in_threadpool(read), media_type="image/jpeg")

    def superpixels(self, request: Request) -> Response:
        """Return the superpixel of each pixel, uint16 (h, w), little endian, row by row."""
        labels = self._session.view(_parameter(request, "name")).labels
        data = labels.numpy().astype("<u2").tobytes()
        return Response(data, media_type="application/octet-stream")

    def state(self, request: Request) -> Response:
        """Return the state of an image."""
        return _state_response(self._session.state(_parameter(request, "name")))

    async def event(self, request: Request) -> Response:
        """Add an event and return the new state of its image."""
        key = self._session.key
        if request.query_params.get("folder", key) != key:
            return error_response(403, "event", "is of another folder", "annotate that one again")
        body = await read_body(request)
        if body is None:
            message = f"has more than {MAX_BODY:,} bytes"
            return error_response(413, "stroke", message, "draw it in shorter strokes")
        event = parse_event(body, "stroke")
        name = _parameter(request, "name")
        return _state_response(await run_in_threadpool(self._session.add, name, event))


def _parameter(request: Request, key: str) -> str:
    return request.query_params.get(key, "")


def _state_response(state: dict[str, Any]) -> Response:
    return JSONResponse({**state, "layers": base64.b64encode(state["layers"]).decode()})


def encode_image(
    path: Path, modified: int, size: WorkingSize = PAGE_IMAGE_SIZE, quality: int = 90
) -> bytes:
    """Encode an image of at most a size as JPEG; InputError where it cannot be read.

    modified: modification time, part of the cache key of ``encode_thumbnail``.
    """
    return jpeg_bytes(to_pixels(resize_to_work(read_image(path), size)), quality)


encode_thumbnail = lru_cache(maxsize=2000)(partial(encode_image, size=THUMBNAIL_SIZE, quality=80))
"""``encode_image`` for thumbnails, cached."""

ERROR_STATUSES = {RoadtorchError: 400, UnwritableError: 507}
"""HTTP status by type of error; the page retries events after 403, 500 and above, drops others."""


async def _handle_error(status: int, _: Request, error: RoadtorchError) -> Response:
    return error_response(status, error.where, error.problem, error.hint)


async def _handle_disk_error(_: Request, error: OSError) -> Response:
    where = str(error.filename or "disk")
    return error_response(507, where, error.strerror or str(error), "check the disk")


# --- start and stop ---------------------------------------------------------------------


class Address(Settings):
    """Port and token of a page, kept so that an open page works again after a restart."""

    port: int = Field(ge=1, le=65535)
    token: str = Field(min_length=20, max_length=100)

    @property
    def url(self) -> str:
        """URL to open in a browser."""
        return f"http://{HOST}:{self.port}/?token={self.token}"


def read_address(out: Path) -> Address | None:
    """Read the last address of a folder of corrections; None where there is none."""
    try:
        return Address.model_validate_json((out / ADDRESS_FILE).read_bytes())
    except (OSError, pydantic.ValidationError):
        return None


def write_address(out: Path, address: Address) -> None:
    """Write the address to a file that only its owner can read."""
    with atomic_write(out / ADDRESS_FILE) as temporary:
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w") as file:
            json.dump(address.model_dump(), file)


def bind_socket(last: int = FIRST_PORT) -> socket.socket:
    """Open a socket that listens on the loopback, at the last port or any free one."""
    for port in (last, FIRST_PORT):
        with suppress(OSError):
            return socket.create_server((HOST, port))
    return socket.create_server((HOST, 0))


@dataclass(eq=False)
class PageServer:
    """A server that is ready to run, with the address of its page."""

    address: Address
    session: Session
    _server: uvicorn.Server
    _listening: socket.socket

    def run(self) -> None:
        """Serve until stopped; run detector and superpixels on all images in the background."""
        stop = threading.Event()
        computing = threading.Thread(target=compute_views, args=(self.session, stop), daemon=True)
        computing.start()
        try:
            self._server.run(sockets=[self._listening])
        finally:
            stop.set()
            computing.join(10)

    def stop(self) -> None:
        """Stop ``run`` from another thread."""
        self._server.should_exit = True


def make_page_server(session: Session) -> PageServer:
    """Create the server of a session, at its last address where that is free, and keep it."""
    last = read_address(session.out)
    listening = bind_socket(last.port if last else FIRST_PORT)
    token = last.token if last else secrets.token_urlsafe(24)
    address = Address(port=listening.getsockname()[1], token=token)
    write_address(session.out, address)
    config = uvicorn.Config(
        make_app(session, token),
        log_level="error",
        access_log=False,
        timeout_graceful_shutdown=2,
    )
    return PageServer(address, session, uvicorn.Server(config), listening)
