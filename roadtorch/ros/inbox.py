"""The newest image message of a topic: what comes while another is looked at takes its place."""

import time
from collections.abc import Iterator
from functools import partial
from threading import Condition
from typing import Any

from roadtorch.base.signals import Stop
from roadtorch.inputs.image_messages import image_of
from roadtorch.inputs.item import Item, Source

WAIT = 0.1  # seconds after which a request to stop is looked for


class Inbox:
    """Holds one message; ``put`` is called by the thread of the subscriptions.

    dropped: how many were replaced before anybody looked. header: std_msgs/Header of the message
    that was taken last. arrived: when that was, by the monotonic clock.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.header: Any = None
        self.arrived = 0.0
        self._newest: tuple[Any, float] | None = None
        self._changed = Condition()

    def put(self, message: Any) -> None:
        """Take a message, in the place of one that nobody has taken."""
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = message, time.monotonic()
            self._changed.notify()

    def take(self) -> Any:
        """The message, once there is one; None after ``WAIT``."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._newest, WAIT) or self._newest is None:
                return None
            (message, self.arrived), self._newest = self._newest, None
            self.header = message.header
            return message

    def source(self, topic: str, stop: Stop) -> Source:
        """The messages as a live source of frames, until somebody asks to stop."""

        def frames() -> Iterator[Item]:
            number = 0
            while not stop.asked:
                if (message := self.take()) is not None:
                    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                    read = partial(image_of, message, topic)
                    yield Item(f"{number:06d}", topic, read, number=number, stamp=stamp)
                    number += 1

        return Source("ros", topic, frames, live=True)
