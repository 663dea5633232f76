"""Ctrl-C and SIGTERM: finish and save the current item, then stop."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

_Value = TypeVar("_Value")

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class SigtermInterrupt(KeyboardInterrupt):
    """Exception for SIGTERM, as KeyboardInterrupt is for SIGINT."""


class StopRequest:
    """A request to stop by a signal."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.raises_at_once = False  # when a request comes, as while waiting for a live source

    @property
    def requested(self) -> bool:
        """True if the program is to stop once the current item is saved."""
        return self.signal is not None

    def raise_if_requested(self) -> None:
        """Raise KeyboardInterrupt or SigtermInterrupt if a stop was requested."""
        if self.signal == signal.SIGTERM:
            raise SigtermInterrupt
        if self.requested:
            raise KeyboardInterrupt

    def request(self, number: int, _: FrameType | None = None) -> None:
        """Record a request, as a signal handler; raise on the second one."""
        self.raise_if_requested()
        self.signal = signal.Signals(number)
        if self.raises_at_once:
            self.raise_if_requested()


@contextmanager
def raise_on_sigterm() -> Iterator[None]:
    """Raise SigtermInterrupt on SIGTERM inside the block, unless SIGTERM is handled or ignored."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    stop = StopRequest()
    stop.raises_at_once = True  # nothing is to be saved first
    signal.signal(signal.SIGTERM, stop.request)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def record_signals() -> Iterator[StopRequest]:
    """Record the signals whose handlers raise inside the block, and still call the handlers.

    Shows whether a signal caused an exception of foreign code. Only handlers in Python are
    wrapped, and only in the main thread, where they run.
    """
    stop = StopRequest()
    is_main = threading.current_thread() is threading.main_thread()
    previous = {number: signal.getsignal(number) for number in STOP_SIGNALS} if is_main else {}

    def record(number: int, frame: FrameType | None) -> None:
        handler = previous[signal.Signals(number)]
        assert callable(handler)
        try:
            handler(number, frame)
        except BaseException:
            stop.signal = signal.Signals(number)
            raise

    try:
        for number, handler in previous.items():
            if callable(handler):
                signal.signal(number, record)
        yield stop
    finally:
        for number, handler in previous.items():
            if signal.getsignal(number) is record:  # unless the block has set another one
                signal.signal(number, handler)


@contextmanager
def prefer_interruption() -> Iterator[None]:
    """Raise KeyboardInterrupt or SigtermInterrupt for a signal, whatever exception it led to.

    Libraries in C or Rust turn a KeyboardInterrupt inside them into errors of their own.
    """
    with record_signals() as stop:
        try:
            yield
        except BaseException:
            stop.raise_if_requested()
            raise


@contextmanager
def block_sigint_in_children() -> Iterator[None]:
    """Block SIGINT in processes started inside the block, and in this thread until its end.

    A terminal sends Ctrl-C to all processes of a command; the first one handles it for them.
    """
    if not hasattr(signal, "pthread_sigmask"):  # not a Unix
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # it starts with the first process, and unblocks SIGINT
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def end_with_parent() -> None:
    """End this process when its parent process ends, even if that was killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Let SIGINT and SIGTERM only request a stop inside the block; then restore the handlers."""
    stop = StopRequest()
    previous = {number: signal.signal(number, stop.request) for number in STOP_SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def until_stopped(
    values: Iterable[_Value], stop: StopRequest, live: bool = False
) -> Iterator[_Value]:
    """Yield values until a stop is requested; do not block on a live source."""
    values = iter(values)
    while not stop.requested:
        stop.raises_at_once = live
        try:
            value = next(values)
        except StopIteration:
            return
        finally:
            stop.raises_at_once = False
        yield value
