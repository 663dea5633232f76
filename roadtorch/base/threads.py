"""Threads: one of torch's for a picture, those of a command's process."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock

_SETTING = Lock()


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside the block, or the function that it decorates, torch computes in the calling thread.

    So that the same picture gives the same bytes: sums shared among threads depend on how many
    there are. Afterwards the thread has the number it had; all others keep theirs throughout.
    """
    import torch

    with _SETTING:  # a new thread takes the common number, which another may just be changing
        before = torch.get_num_threads()
    if before == 1:
        yield
        return
    _set_own(1)
    try:
        yield
    finally:
        _set_own(before)


def _set_own(number: int) -> None:
    """``torch.set_num_threads`` for the calling thread alone.

    torch's own function also sets what new threads begin with: another thread, new itself, looks
    that number up and puts it back.
    """
    import torch

    with _SETTING, ThreadPoolExecutor(1) as new:
        common = new.submit(torch.get_num_threads).result()
        torch.set_num_threads(number)
        new.submit(torch.set_num_threads, common).result()


@dataclass(frozen=True)
class Threads:
    """The threads of torch and of OpenCV within one picture."""

    torch: int
    opencv: int

    @classmethod
    def of_now(cls) -> "Threads":
        """Those of this process."""
        import cv2
        import torch

        return cls(torch.get_num_threads(), cv2.getNumThreads())

    def set(self) -> None:
        """Let this process have as many."""
        import cv2
        import torch

        torch.set_num_threads(self.torch)
        cv2.setNumThreads(self.opencv)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Inside the block this process computes on one thread, and so do copies of it."""
    before = Threads.of_now()
    Threads(1, 1).set()
    try:
        yield
    finally:
        before.set()
