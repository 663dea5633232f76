"""The server of the page: its routes, who may speak to it, and how much they may say.

It listens on the loopback interface alone, but every page that a browser shows can send requests
there, and a foreign name can be made to point there (DNS rebinding). So: the Host header must be
the loopback's, the token must come with every request for data, and pages that we send may load
nothing but what we serve.
"""

import base64
import hashlib
import json
import secrets
from collections.abc import Awaitable, Callable
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from roadtorch.annotate.session import Session
from roadtorch.data.events import parse_event
from roadtorch.errors import RoadtorchError
from roadtorch.imaging.resize import WorkingSize, resized, working_size
from roadtorch.io.image import read_image, to_pixels

STATIC = {
    "annotate.css": "text/css",
    "annotate.js": "text/javascript",
    "canvas.js": "text/javascript",
    "controls.js": "text/javascript",
    "hand.js": "text/javascript",
    "link.js": "text/javascript",
    "list.js": "text/javascript",
}
"""The page's files, by name, with their type."""

SHOWN = WorkingSize(pixels=1600 * 1200)
"""What is sent of a picture at most; strokes are in pixels of the whole one."""

THUMBNAIL = WorkingSize(pixels=112 * 84)

MAX_BODY = 2 * 2**20  # bytes of one event; ours: a long stroke has some ten thousand

MAX_DRAINED = 64 * 2**20  # bytes of a refused body that are read, so that the refusal arrives

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

Answer = Callable[[Request], Awaitable[Response]]


def refusal(status: int, where: str, what: str, remedy: str) -> JSONResponse:
    """What is wrong, as the page shows it."""
    return JSONResponse({"error": f"{where}: {what} ({remedy})"}, status)


class Guard:
    """Lets requests through that name this host and bear the token."""

    def __init__(self, token: str, port: int) -> None:
        self._token = token
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}

    async def __call__(self, request: Request, answer: Answer) -> Response:
        """The answer, with the headers that every answer has; a refusal where one is due."""
        response = self._refused(request) or await answer(request)
        response.headers.update(HEADERS)
        return response

    def _refused(self, request: Request) -> Response | None:
        host = request.headers.get("host", "")
        if host not in self._hosts:
            return refusal(421, host[:100] or "host", "is not this server", "use 127.0.0.1")
        if request.url.path.startswith("/static/"):
            return None  # public code, the same for everybody
        given = request.headers.get("x-token") or request.query_params.get("token", "")
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            remedy = "open the address that roadtorch annotate printed"
            return refusal(403, "token", "is missing or wrong", remedy)
        return None


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
    app = Starlette(routes=routes, exception_handlers=handlers)
    app.add_middleware(BaseHTTPMiddleware, dispatch=Guard(token, port))
    return app


def page_file(name: str) -> bytes:
    """One of the files that the page is made of."""
    return files("roadtorch.annotate").joinpath("static", name).read_bytes()


class Page:
    """What the page asks for, of a session; pictures and users by ``name`` and ``user``."""

    def __init__(self, session: Session) -> None:
        self._session = session

    async def start(self, _: Request) -> Response:
        """The page itself."""
        return Response(page_file("annotate.html"), media_type="text/html")

    async def static(self, request: Request) -> Response:
        """One of its files."""
        name = request.path_params["name"]
        if name not in STATIC:
            return refusal(404, name, "is no file of the page", "load the page again")
        return Response(page_file(name), media_type=STATIC[name])

    async def pictures(self, request: Request) -> Response:
        """The list; 204 for who has this very list already."""
        listing = await run_in_threadpool(self._session.listing)
        stamp = hashlib.sha256(json.dumps(listing).encode()).hexdigest()[:16]
        if request.query_params.get("stamp") == stamp:
            return Response(status_code=204)
        return JSONResponse({"stamp": stamp, "pictures": listing})

    async def picture(self, request: Request) -> Response:
        """A picture as JPEG."""
        path = self._session.pictures.path(_given(request, "name"))
        data = await run_in_threadpool(picture_jpeg, path, SHOWN, 90)
        return Response(data, media_type="image/jpeg")

    async def thumbnail(self, request: Request) -> Response:
        """The same, small."""
        path = self._session.pictures.path(_given(request, "name"))
        data = await run_in_threadpool(thumbnail_jpeg, path, path.stat().st_mtime_ns)
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
    small = resized(image, working_size(image.shape[-2], image.shape[-1], most)).clamp(0, 1)
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
