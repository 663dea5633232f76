"""The server of the page: its routes, who may speak to it, and how much they may say.

It listens on the loopback interface alone, but every page that a browser shows can send requests
there, and a foreign name can be made to point there (DNS rebinding). So: the Host header must be
the loopback's, an Origin that a browser sends its own, the token must come with every request for
data, and pages that we send may load nothing but what we serve.
"""

import asyncio
import base64
import hashlib
import json
import secrets
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from pathlib import Path, PurePath
from typing import Any

import cv2
import h11
import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from roadtorch.annotate.session import Session
from roadtorch.data.events import parse_event
from roadtorch.errors import RoadtorchError
from roadtorch.imaging.resize import WorkingSize, resized, size_of, working_size
from roadtorch.io.image import read_image, to_pixels

TYPES = {".css": "text/css", ".js": "text/javascript", ".html": "text/html"}

PAGE = {
    one.name: one.read_bytes() for one in files("roadtorch.annotate").joinpath("static").iterdir()
}
"""The page's files."""

SHOWN = WorkingSize(pixels=1600 * 1200)
"""What is sent of a picture at most; strokes are in pixels of the whole one."""

THUMBNAIL = WorkingSize(pixels=112 * 84)

MAX_BODY = 2 * 2**20  # bytes of one event; ours: a long stroke has some ten thousand

MAX_DRAINED = 64 * 2**20  # bytes of a refused body that are read, so that the refusal arrives

DECODED = 2  # pictures at a time: each takes some ten times its bytes

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


def refusal(status: int, where: str, what: str, remedy: str) -> JSONResponse:
    """What is wrong, as the page shows it."""
    return JSONResponse({"error": f"{where}: {what} ({remedy})"}, status)


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
        given = request.headers.get("x-token") or request.query_params.get("token", "")
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            remedy = "open the address that roadtorch annotate printed"
            return refusal(403, "token", "is missing or wrong", remedy)
        return None


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
        Route("/", page.start),
        Route("/static/{name}", page.static),
        Route("/api/pictures", page.pictures),
        Route("/api/picture", page.picture),
        Route("/api/thumbnail", page.thumbnail),
        Route("/api/superpixels", page.superpixels),
        Route("/api/state", page.state),
        Route("/api/event", page.event, methods=["POST"]),
    ]
    handlers: dict[Any, Any] = {RoadtorchError: _mistake, OSError: _disk}
    guard = Middleware(Guard, token=token, port=port)
    return Starlette(routes=routes, middleware=[guard], exception_handlers=handlers)


class Page:
    """What the page asks for, of a session; pictures and users by ``name`` and ``user``."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._few = asyncio.Semaphore(DECODED)

    async def start(self, _: Request) -> Response:
        """The page itself."""
        return Response(PAGE["annotate.html"], media_type=TYPES[".html"])

    async def static(self, request: Request) -> Response:
        """One of its files."""
        name = request.path_params["name"]
        if name not in PAGE:
            return refusal(404, name, "is no file of the page", "load the page again")
        return Response(PAGE[name], media_type=TYPES[PurePath(name).suffix])

    async def pictures(self, request: Request) -> Response:
        """The list; 204 for who has this very list already."""
        listing = await run_in_threadpool(self._session.listing)
        hasty = await run_in_threadpool(self._session.hasty)
        stamp = hashlib.sha256(json.dumps([listing, hasty]).encode()).hexdigest()[:16]
        if request.query_params.get("stamp") == stamp:
            return Response(status_code=204)
        return JSONResponse({"stamp": stamp, "pictures": listing, "hasty": hasty})

    async def picture(self, request: Request) -> Response:
        """A picture as JPEG."""
        return await self._jpeg(request, lambda path: picture_jpeg(path, SHOWN, 90))

    async def thumbnail(self, request: Request) -> Response:
        """The same, small."""
        return await self._jpeg(request, lambda p: thumbnail_jpeg(p, p.stat().st_mtime_ns))

    async def _jpeg(self, request: Request, encoded: Callable[[Path], bytes]) -> Response:
        async with self._few:
            path = await run_in_threadpool(self._session.pictures.path, _given(request, "name"))
            data = await run_in_threadpool(encoded, path)
        return Response(data, media_type="image/jpeg")

    async def superpixels(self, request: Request) -> Response:
        """The number of each pixel's superpixel, uint16 (h,w), little endian, row by row."""
        view = await run_in_threadpool(self._session.view, _given(request, "name"))
        data = view.labels.numpy().astype("<u2").tobytes()
        return Response(data, media_type="application/octet-stream")

    async def state(self, request: Request) -> Response:
        """A person's picture as it stands."""
        name, user = _given(request, "name"), _given(request, "user")
        return _told(await run_in_threadpool(self._session.state, name, user))

    async def event(self, request: Request) -> Response:
        """Take what a person did, and tell how the picture stands then."""
        body = await bounded_body(request)
        if body is None:
            what, remedy = f"has more than {MAX_BODY:,} bytes", "draw it in shorter strokes"
            return refusal(413, "stroke", what, remedy)
        event = parse_event(body, "stroke")
        name, user = _given(request, "name"), _given(request, "user")
        return _told(await run_in_threadpool(self._session.add, name, user, event))


def _given(request: Request, key: str) -> str:
    return request.query_params.get(key, "")


def _told(state: dict[str, Any]) -> Response:
    return JSONResponse({**state, "layers": base64.b64encode(state["layers"]).decode()})


def picture_jpeg(path: Path, most: WorkingSize, quality: int) -> bytes:
    """A picture at a size of at most so many pixels as JPEG; InputError if it cannot be read."""
    image = read_image(path)
    small = resized(image, working_size(*size_of(image), most)).clamp(0, 1)
    pixels = np.ascontiguousarray(to_pixels(small)[..., ::-1])
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


@lru_cache(maxsize=2000)
def thumbnail_jpeg(path: Path, changed: int) -> bytes:
    """A thumbnail; ``changed`` is the file's time, so that a new picture has a new one."""
    return picture_jpeg(path, THUMBNAIL, 80)


async def _mistake(_: Request, problem: RoadtorchError) -> Response:
    """What a person can mend, told as everywhere; 410 for what is gone."""
    status = 410 if "no longer there" in problem.what else 400
    if "cannot be written" in problem.what:
        status = 507
    return refusal(status, problem.where, problem.what, problem.remedy)


async def _disk(_: Request, problem: OSError) -> Response:
    where = str(problem.filename or "disk")
    return refusal(507, where, problem.strerror or str(problem), "look at the disk")
