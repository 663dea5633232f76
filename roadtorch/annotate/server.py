"""The server of the page: its port and token, its routes, who may speak and how much.

It listens on the loopback interface alone, but every page that a browser shows can send requests
there, and a foreign name can be made to point there (DNS rebinding). So: the Host header must be
the loopback's, an Origin that a browser sends its own, the token must come with every request for
data, and pages that we send may load nothing but what we serve.
"""

import asyncio
import base64
import hashlib
import json
import os
import secrets
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path, PurePath
from typing import Any

import cv2
import h11
import numpy as np
import pydantic
import uvicorn
from pydantic import Field
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from roadtorch.annotate.session import Session, look_at_all
from roadtorch.base.atomic import atomic
from roadtorch.base.errors import ConfigError, RoadtorchError, UnwritableError
from roadtorch.base.image import read_image, to_pixels
from roadtorch.base.settings import Settings
from roadtorch.data.events import parse_event
from roadtorch.imaging.resize import WorkingSize, resized, size_of, working_size

HOST = "127.0.0.1"  # and never another one

FIRST_PORT = 8765

FILE = ".session.json"


TYPES = {".css": "text/css", ".js": "text/javascript", ".html": "text/html"}

PAGE = {
    file.name: file.read_bytes()
    for file in files("roadtorch.annotate").joinpath("static").iterdir()
}
"""The page's files."""

SHOWN = WorkingSize(pixels=1600 * 1200)
"""What is sent of an image at most; strokes are in pixels of the whole one."""

THUMBNAIL = WorkingSize(pixels=112 * 84)

MAX_BODY = 2 * 2**20  # bytes of one event; ours: a long stroke has some ten thousand

MAX_DRAINED = 64 * 2**20  # bytes of a refused body that are read, so that the refusal arrives

LEARN = (
    "roadtorch train --config corrections --images {images} --corrections {out} "
    "--out runs/corrected"
)
"""What learns from the corrections, once all images are right."""

DECODED = 2  # images at a time: each takes some ten times its bytes

PATIENCE = 20.0  # seconds after which a client that sends or reads nothing whole is closed

HEADERS = {
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


# --- who may speak ----------------------------------------------------------------------


def refusal(status: int, where: str, problem: str, hint: str) -> JSONResponse:
    """What is wrong, as the page shows it."""
    return JSONResponse({"error": f"{where}: {problem} ({hint})"}, status)


class Guard:
    """Lets requests through that name this host and bear the token; gives all answers ``HEADERS``.

    Who is cut off at the end of the server is told to ask again.
    """

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self._app = app
        self._token = token
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        begun = False

        async def sent(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        try:
            await (self._refused(Request(scope)) or self._app)(scope, receive, sent)
        except asyncio.CancelledError:
            if not begun:
                ended = refusal(503, "server", "was ended", "start roadtorch annotate again")
                await ended(scope, receive, sent)

    def _refused(self, request: Request) -> Response | None:
        host = request.headers.get("host", "")
        if host not in self._hosts:
            return refusal(421, host[:100] or "host", "is not this server", "use 127.0.0.1")
        origin = request.headers.get("origin", f"http://{host}")
        if origin != f"http://{host}":
            return refusal(403, origin[:100], "is another page", "use the page of this server")
        if request.url.path.startswith("/static/"):
            return None  # public code, the same for everybody
        token = request.headers.get("x-token") or request.query_params.get("token", "")
        if secrets.compare_digest(token.encode(), self._token.encode()):
            return None
        hint = "open the address that roadtorch printed"
        return refusal(403, "token", "is missing or wrong", hint)


class Impatient(H11Protocol):
    """A connection that ends when its client neither sends a whole request nor reads its answer."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore
        """Look after it from now on."""
        super().connection_made(transport)
        self.loop.call_later(PATIENCE, self._look, None)

    def _look(self, last: object) -> None:
        """last: the request at the last look."""
        unread = self.transport.get_write_buffer_size() > 0
        unsaid = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        if self.cycle is last and (unread or unsaid):
            self.transport.abort()
        elif unread or not self.transport.is_closing():
            self.loop.call_later(PATIENCE, self._look, self.cycle)


async def bounded_body(request: Request) -> bytes | None:
    """The body of a request; None for one of more than ``MAX_BODY`` bytes."""
    body, length = bytearray(), 0
    async for chunk in request.stream():
        length += len(chunk)
        if length <= MAX_BODY:
            body += chunk
        if length > MAX_DRAINED:
            break
    return bytes(body) if length <= MAX_BODY else None


# --- routes -----------------------------------------------------------------------------


def annotation_app(session: Session, token: str, port: int) -> Starlette:
    """The page of a session, for those who have the token."""
    page = Page(session)
    routes = [
        Route("/", lambda _: Response(PAGE["annotate.html"], media_type=TYPES[".html"])),
        Route("/static/{name}", static_file),
        Route("/api/images", page.images),
        Route("/api/image", partial(page.jpeg, shown_jpeg)),
        Route("/api/thumbnail", partial(page.jpeg, thumbnail_jpeg)),
        Route("/api/superpixels", page.superpixels),
        Route("/api/state", page.state),
        Route("/api/event", page.event, methods=["POST"]),
    ]
    handlers: dict[Any, Any] = {kind: partial(_refuse, status) for kind, status in STATUSES.items()}
    handlers[OSError] = _disk
    guard = Middleware(Guard, token=token, port=port)
    return Starlette(routes=routes, middleware=[guard], exception_handlers=handlers)


def static_file(request: Request) -> Response:
    """One of the page's files."""
    name = request.path_params["name"]
    if name not in PAGE:
        return refusal(404, name, "is no file of the page", "load the page again")
    return Response(PAGE[name], media_type=TYPES[PurePath(name).suffix])


class Page:
    """What the page asks for, of a session; images by ``name``."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._few = asyncio.Semaphore(DECODED)

    def images(self, request: Request) -> Response:
        """The list; 204 for who has this very list already."""
        listing = self._session.listing()
        learn = LEARN.format(images=self._session.images.root, out=self._session.out)
        stamp = hashlib.sha256(json.dumps(listing).encode()).hexdigest()[:16]
        if request.query_params.get("stamp") == stamp:
            return Response(status_code=204)
        return JSONResponse({"stamp": stamp, "images": listing, "learn": learn})

    async def jpeg(self, encode: Callable[[Path, int], bytes], request: Request) -> Response:
        """An image as JPEG; ``encode`` makes it of the file, which was changed at a time."""

        def encoded() -> bytes:
            path = self._session.images.path(_given(request, "name"))
            return encode(path, path.stat().st_mtime_ns)

        async with self._few:  # who waits here takes no thread from those who draw
            return Response(await run_in_threadpool(encoded), media_type="image/jpeg")

    def superpixels(self, request: Request) -> Response:
        """The number of each pixel's superpixel, uint16 (h,w), little endian, row by row."""
        labels = self._session.view(_given(request, "name")).labels
        data = labels.numpy().astype("<u2").tobytes()
        return Response(data, media_type="application/octet-stream")

    def state(self, request: Request) -> Response:
        """Return an image as it stands."""
        return _state(self._session.state(_given(request, "name")))

    async def event(self, request: Request) -> Response:
        """Take what a person did, and tell how the image stands then."""
        body = await bounded_body(request)
        if body is None:
            message = f"has more than {MAX_BODY:,} bytes"
            return refusal(413, "stroke", message, "draw it in shorter strokes")
        event = parse_event(body, "stroke")
        return _state(await run_in_threadpool(self._session.add, _given(request, "name"), event))


def _given(request: Request, key: str) -> str:
    return request.query_params.get(key, "")


def _state(state: dict[str, Any]) -> Response:
    return JSONResponse({**state, "layers": base64.b64encode(state["layers"]).decode()})


def shown_jpeg(path: Path, changed: int, most: WorkingSize = SHOWN, quality: int = 90) -> bytes:
    """An image at a size of at most so many pixels as JPEG; InputError if it cannot be read."""
    image = read_image(path)
    small = resized(image, working_size(*size_of(image), most)).clamp(0, 1)
    pixels = np.ascontiguousarray(to_pixels(small)[..., ::-1])
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


thumbnail_jpeg = lru_cache(maxsize=2000)(partial(shown_jpeg, most=THUMBNAIL, quality=80))
"""The same, small; a file that changed has a new one."""


STATUSES = {RoadtorchError: 400, UnwritableError: 507}
"""HTTP status by kind of error; the page keeps what was refused with 500 and more."""


async def _refuse(status: int, _: Request, error: RoadtorchError) -> Response:
    return refusal(status, error.where, error.problem, error.hint)


async def _disk(_: Request, error: OSError) -> Response:
    where = str(error.filename or "disk")
    return refusal(507, where, error.strerror or str(error), "look at the disk")


# --- its life ---------------------------------------------------------------------------


class Address(Settings):
    """Where a page was last, so that one that is open finds a server that was started again."""

    port: int = Field(ge=1, le=65535)
    token: str = Field(min_length=20, max_length=100)

    @property
    def url(self) -> str:
        """What to open in a browser."""
        return f"http://{HOST}:{self.port}/?token={self.token}"


def last_address(out: Path) -> Address | None:
    """The address that was used for a folder of corrections before, if it is known."""
    try:
        return Address.model_validate_json((out / FILE).read_bytes())
    except (OSError, pydantic.ValidationError):
        return None


def keep_address(out: Path, address: Address) -> None:
    """Remember the address; the file is for its owner alone."""
    with atomic(out / FILE) as temporary:
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w") as file:
            json.dump(address.model_dump(), file)


def bound_socket(port: int | None, last: int | None) -> socket.socket:
    """A listening socket on the loopback interface.

    port: the one that was asked for; ConfigError where it is taken. Else the last one, the first,
    or any that is free.
    """
    for candidate in [last or FIRST_PORT, FIRST_PORT, 0] if port is None else [port]:
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, candidate))
            listening.listen()
        except OSError:
            listening.close()
        else:
            return listening
    raise ConfigError("--port", f"{port} is taken", "give another one, or leave it out")


@dataclass
class PageServer:
    """A server that is ready to run. address: where its page is."""

    address: Address
    session: Session
    _server: uvicorn.Server
    _listening: socket.socket

    def run(self) -> None:
        """Serve, and look at the images meanwhile, until interrupted or told to stop."""
        stop = threading.Event()
        looking = threading.Thread(target=look_at_all, args=(self.session, stop), daemon=True)
        looking.start()
        try:
            self._server.run(sockets=[self._listening])
        finally:
            stop.set()
            looking.join(10)

    def stop(self) -> None:
        """End ``run``, from another thread."""
        self._server.should_exit = True


def page_server(session: Session, port: int | None = None) -> PageServer:
    """The server of a session's page, its port taken and its address kept for a restart.

    Raises ConfigError for a port that is taken.
    """
    last = last_address(session.out)
    listening = bound_socket(port, last.port if last else None)
    token = last.token if last else secrets.token_urlsafe(24)
    address = Address(port=listening.getsockname()[1], token=token)
    keep_address(session.out, address)
    app = annotation_app(session, token, address.port)
    config = uvicorn.Config(
        app, http=Impatient, log_level="error", access_log=False, timeout_graceful_shutdown=2
    )
    return PageServer(address, session, uvicorn.Server(config), listening)
