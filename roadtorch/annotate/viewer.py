"""A page on localhost that shows the newest frame of footage, its trust and the frame rate."""

import secrets
import time
from collections import deque
from collections.abc import Mapping
from threading import Condition, Thread
from typing import Self

import uvicorn
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from roadtorch.annotate.server import Address, bind_socket, page_app
from roadtorch.base.image import jpeg_bytes
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item

FRAME_TIMEOUT = 5.0  # seconds that a request waits for a newer frame
RATE_FRAMES = 30  # frames over which the rate is measured
PAGE_TIMEOUT = 2.0  # seconds for open requests when the page closes


class Viewer:
    """A page that shows each frame as it is written, while the block runs, at ``address``."""

    def __init__(self) -> None:
        self._listening, token = bind_socket(), secrets.token_urlsafe(24)
        self.address = Address(port=self._listening.getsockname()[1], token=token)
        self._changed, self._number, self._ended = Condition(), 0, False
        self._newest: tuple[Item, Detection] | None = None
        self._times = deque[float](maxlen=RATE_FRAMES)
        routes = [Route("/api/frame", self._frame)]
        config = uvicorn.Config(
            page_app("view.html", routes, token),
            log_level="error",
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        sockets = {"sockets": [self._listening]}
        self._thread = Thread(target=self._server.run, kwargs=sockets, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Answer waiting requests with the end of the stream, and stop the server."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._server.should_exit = True
        self._thread.join(PAGE_TIMEOUT)
        self._listening.close()

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Show a frame."""
        with self._changed:
            self._times.append(time.monotonic())
            self._newest, self._number = (item, detection), self._number + 1
            self._changed.notify_all()
        return {}

    def _frame(self, request: Request) -> Response:
        """Wait for a frame newer than ``after`` and send it as JPEG; 204: none yet, 410: ended."""
        after = request.query_params.get("after", "")
        with self._changed:
            self._changed.wait_for(lambda: self._ended or str(self._number) != after, FRAME_TIMEOUT)
            newest, number, times = self._newest, str(self._number), [*self._times]
        if number == after or newest is None:
            return Response(status_code=410 if self._ended else 204)
        (item, detection), seconds = newest, times[-1] - times[0]
        headers = {
            "X-Number": number,
            "X-Frame": str(item.number),
            "X-Trust": "" if detection.trust is None else f"{detection.trust:.2f}",
            "X-Rate": f"{(len(times) - 1) / seconds:.1f}" if seconds else "",
        }
        data = jpeg_bytes(detection.overlay())  # drawn only on request
        return Response(data, headers=headers, media_type="image/jpeg")
