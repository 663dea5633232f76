"""The newest frame of footage on a page of this computer alone, with its trust and the rate."""

import secrets
import time
from collections import deque
from collections.abc import Mapping
from threading import Condition, Thread
from typing import Self

import cv2
import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from roadtorch.annotate.server import (
    PAGE,
    TYPES,
    Address,
    Guard,
    Impatient,
    bound_socket,
    static_file,
)
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item

NEXT = 5.0  # seconds that a request waits for a newer frame

RATED = 30  # frames over which the rate is measured

ENDING = 2.0  # seconds for pages that are still being answered


class Viewer:
    """A page that shows each frame as it is written, while the block runs.

    address: what to open.
    """

    def __init__(self) -> None:
        self._listening, token = bound_socket(None, None), secrets.token_urlsafe(24)
        self.address = Address(port=self._listening.getsockname()[1], token=token)
        self._changed, self._number, self._ended = Condition(), 0, False
        self._newest: tuple[Item, Detection] | None = None
        self._times = deque[float](maxlen=RATED)
        routes = [
            Route("/", lambda _: Response(PAGE["view.html"], media_type=TYPES[".html"])),
            Route("/static/{name}", static_file),
            Route("/api/frame", self._frame),
        ]
        guard = Middleware(Guard, token=token, port=self.address.port)
        app = Starlette(routes=routes, middleware=[guard])
        self._server = uvicorn.Server(
            uvicorn.Config(app, http=Impatient, log_level="error", timeout_graceful_shutdown=1)
        )
        sockets = {"sockets": [self._listening]}
        self._thread = Thread(target=self._server.run, kwargs=sockets, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Tell open pages that this was the last frame, and end."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._server.should_exit = True
        self._thread.join(ENDING)
        self._listening.close()

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Show a frame."""
        with self._changed:
            self._times.append(time.monotonic())
            self._newest, self._number = (item, detection), self._number + 1
            self._changed.notify_all()
        return {}

    def close(self) -> None:
        """Of the source; the page outlives it."""

    def _frame(self, request: Request) -> Response:
        """The newest frame as JPEG, once it is newer than ``after``; 204: not yet, 410: no more."""
        seen = request.query_params.get("after", "")
        with self._changed:
            self._changed.wait_for(lambda: self._ended or str(self._number) != seen, NEXT)
            newest, number, times = self._newest, str(self._number), [*self._times]
        if number == seen or newest is None:
            return Response(status_code=410 if self._ended else 204)
        (item, detection), behind = newest, times[-1] - times[0]
        about = {
            "X-Number": number,
            "X-Frame": str(item.number),
            "X-Trust": "" if detection.trust is None else f"{detection.trust:.2f}",
            "X-Rate": f"{(len(times) - 1) / behind:.1f}" if behind else "",
        }
        pixels = np.ascontiguousarray(detection.overlay()[..., ::-1])  # drawn for who looks alone
        data = cv2.imencode(".jpg", pixels)[1].tobytes()
        return Response(data, headers=about, media_type="image/jpeg")
