"""Ctrl-C and termination: finish what is in hand, save, and leave."""

import multiprocessing
import os
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
    """Whether somebody asked to stop, and by which signal.

    at_once: whether asking raises, as while a live source is waited for.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.at_once = False

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
        if self.at_once:
            self.interrupt()


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
def noted_signals() -> Iterator[Stop]:
    """Within the block, signals that raise are noted as well; what handled them still does.

    Of an exception from foreign code it can then be said whether a signal was its cause. Only
    handlers written in Python are looked at, and in the main thread alone, where they run.
    """
    stop = Stop()
    own = threading.current_thread() is threading.main_thread()
    before = {number: signal.getsignal(number) for number in SIGNALS} if own else {}

    def note(number: int, frame: FrameType | None) -> None:
        handler = before[signal.Signals(number)]
        assert callable(handler)
        try:
            handler(number, frame)
        except BaseException:
            stop.signal = signal.Signals(number)
            raise

    try:
        for number, handler in before.items():
            if callable(handler):
                signal.signal(number, note)
        yield stop
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is note:  # unless the block has set one of its own
                signal.signal(number, handler)


@contextmanager
def interruption_first() -> Iterator[None]:
    """Raise an interruption as such, whatever the block's code or its libraries make of it.

    Libraries in C or Rust turn a KeyboardInterrupt that meets them into errors of their own.
    """
    with noted_signals() as stop:
        try:
            yield
        except BaseException:
            stop.interrupt()
            raise


@contextmanager
def interrupting_none_started() -> Iterator[None]:
    """Processes that are started within the block never see SIGINT; here it waits for the end.

    A terminal sends Ctrl-C to all processes of a command. The first one answers for them.
    """
    if not hasattr(signal, "pthread_sigmask"):  # not a Unix
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # as it starts, with the first process, it lets SIGINT in
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """Let this process end when the one that started it does, even if that was killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


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
