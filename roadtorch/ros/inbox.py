"""Images that wait for the node: a queue a camera, taken in turn."""

import time
from collections import deque
from collections.abc import Iterable
from threading import Condition
from typing import Any, NamedTuple

POLL_PERIOD = 0.1  # seconds between checks for a stop request

BURST = 3
"""Images of a camera that wait at most; ours: at 30 Hz, a delay of a tenth of a second."""


class Arrival(NamedTuple):
    """An image message of a camera. time: of its arrival, ``time.monotonic``."""

    camera: str
    message: Any
    time: float


class Inbox:
    """Queues of image messages, a queue a camera; ``put`` is called by the executor's thread.

    Where more than ``BURST`` images wait, they arrive faster than they are processed: only the
    newest of each camera is kept then, until no image waits.
    """

    def __init__(self, cameras: Iterable[str]) -> None:
        self._queues = {camera: deque[Arrival]() for camera in cameras}  # the next camera first
        self.dropped = dict.fromkeys(self._queues, 0)
        self._limit = BURST
        self._changed = Condition()

    def put(self, camera: str, message: Any) -> None:
        """Add a message of a camera, in place of those that wait if they are too many."""
        with self._changed:
            queue = self._queues[camera]
            if len(queue) >= self._limit:
                self._limit = 1
                self.dropped[camera] += len(queue)
                queue.clear()
            queue.append(Arrival(camera, message, time.monotonic()))
            self._changed.notify()

    def take(self) -> Arrival | None:
        """Wait for a message and return it, cameras in turn; None after ``POLL_PERIOD``."""
        with self._changed:
            if not any(self._queues.values()):
                self._limit = BURST
            self._changed.wait_for(lambda: any(self._queues.values()), POLL_PERIOD)
            camera = next((name for name, queue in self._queues.items() if queue), None)
            if camera is None:
                return None
            queue = self._queues[camera] = self._queues.pop(camera)
            return queue.popleft()
