"""Ctrl-C and termination: finish what is in hand, save, and leave."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM came: what a KeyboardInterrupt is for SIGINT."""


def raise_terminated(*_: object) -> NoReturn:
    """The handler of SIGTERM for a process that has nothing in hand to save."""
    raise Terminated


class Stop:
    """Whether somebody asked to stop, and by which signal."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    @property
    def asked(self) -> bool:
        """Whether to stop as soon as what is in hand is saved."""
        return self.signal is not None

    def interrupt(self) -> None:
        """Raise KeyboardInterrupt, or Terminated, if somebody asked to stop."""
        if self.signal == signal.SIGTERM:
            raise Terminated
        if self.asked:
            raise KeyboardInterrupt

    def ask(self, number: int, _: FrameType | None = None) -> None:
        """Remember the request; the second one no longer waits."""
        self.interrupt()
        self.signal = signal.Signals(number)


@contextmanager
def terminated_in_words() -> Iterator[None]:
    """Within the block SIGTERM raises Terminated, unless somebody handles or ignores it."""
    own = threading.current_thread() is threading.main_thread()
    if not own or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, raise_terminated)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """Within the block, SIGINT and SIGTERM only ask; the handlers before it come back."""
    stop = Stop()
    before = {number: signal.signal(number, stop.ask) for number in SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
