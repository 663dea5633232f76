"""The server of the page: its routes, over a session."""

import base64
import hashlib
import json
from importlib.resources import files
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from roadtorch.annotate.answers import SHOWN, picture_jpeg, superpixel_bytes, thumbnail_jpeg
from roadtorch.annotate.guard import MOST_BODY, Guard, bounded_body, refusal
from roadtorch.annotate.session import Session
from roadtorch.data.strokes import parse_act
from roadtorch.errors import RoadtorchError

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


def annotation_app(session: Session, token: str, port: int) -> Starlette:
    """The page of a session, for those who have the token."""
    routes = [
        Route("/", _page),
        Route("/static/{name}", _static),
        Route("/api/pictures", _pictures),
        Route("/api/picture", _picture),
        Route("/api/thumbnail", _thumbnail),
        Route("/api/superpixels", _superpixels),
        Route("/api/state", _state),
        Route("/api/act", _act, methods=["POST"]),
    ]
    handlers: dict[Any, Any] = {RoadtorchError: _mistake, OSError: _disk}
    app = Starlette(routes=routes, exception_handlers=handlers)
    app.add_middleware(BaseHTTPMiddleware, dispatch=Guard(token, port))
    app.state.session = session
    return app


def page_file(name: str) -> bytes:
    """One of the files that the page is made of."""
    return files("roadtorch.annotate").joinpath("static", name).read_bytes()


async def _page(_: Request) -> Response:
    return Response(page_file("annotate.html"), media_type="text/html")


async def _static(request: Request) -> Response:
    name = request.path_params["name"]
    if name not in STATIC:
        return refusal(404, name, "is no file of the page", "load the page again")
    return Response(page_file(name), media_type=STATIC[name])


async def _pictures(request: Request) -> Response:
    """The list; 204 for who has this very list already."""
    session: Session = request.app.state.session
    listing = await run_in_threadpool(session.listing)
    text = json.dumps(listing)
    stamp = hashlib.sha256(text.encode()).hexdigest()[:16]
    if request.query_params.get("stamp") == stamp:
        return Response(status_code=204)
    return JSONResponse({"stamp": stamp, "pictures": listing})


async def _picture(request: Request) -> Response:
    session: Session = request.app.state.session
    path = session.pictures.path(_name(request))
    return Response(await run_in_threadpool(picture_jpeg, path, SHOWN, 90), media_type="image/jpeg")


async def _thumbnail(request: Request) -> Response:
    session: Session = request.app.state.session
    path = session.pictures.path(_name(request))
    data = await run_in_threadpool(thumbnail_jpeg, path, path.stat().st_mtime_ns)
    return Response(data, media_type="image/jpeg")


async def _superpixels(request: Request) -> Response:
    session: Session = request.app.state.session
    view = await run_in_threadpool(session.view, _name(request))
    return Response(superpixel_bytes(view), media_type="application/octet-stream")


async def _state(request: Request) -> Response:
    session: Session = request.app.state.session
    return _told(await run_in_threadpool(session.state, _name(request), _user(request)))


async def _act(request: Request) -> Response:
    session: Session = request.app.state.session
    body = await bounded_body(request)
    if body is None:
        what, remedy = f"has more than {MOST_BODY:,} bytes", "draw it in shorter strokes"
        return refusal(413, "stroke", what, remedy)
    act = parse_act(body, "stroke")
    return _told(await run_in_threadpool(session.act, _name(request), _user(request), act))


def _told(state: dict[str, Any]) -> Response:
    return JSONResponse({**state, "layers": base64.b64encode(state["layers"]).decode()})


def _name(request: Request) -> str:
    return request.query_params.get("name", "")


def _user(request: Request) -> str:
    return request.query_params.get("user", "")


async def _mistake(_: Request, problem: RoadtorchError) -> Response:
    """What a person can mend, told as everywhere; 410 for what is gone."""
    status = 410 if "no longer there" in problem.what else 400
    if "cannot be written" in problem.what:
        status = 507
    return refusal(status, problem.where, problem.what, problem.remedy)


async def _disk(_: Request, problem: OSError) -> Response:
    where = str(problem.filename or "disk")
    return refusal(507, where, problem.strerror or str(problem), "look at the disk")
