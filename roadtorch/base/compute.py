"""What a process computes with: threads of torch and OpenCV, memory, a device of torch."""

import ctypes
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from roadtorch.base.errors import ConfigError

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3  # numbers of glibc's mallopt(3)

KEPT = 2**28
"""Bytes of freed memory that stay with the process at most; ours: fusion frees 30 MB an image."""

_SETTING = Lock()


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside the block, or the function that it decorates, torch computes in the calling thread.

    So that the same image gives the same bytes: sums shared among threads depend on how many
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
    """The threads of torch and of OpenCV within one image."""

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


# --- memory and device ------------------------------------------------------------------


def keep_freed_memory() -> None:
    """Let this process keep freed memory for the next image, where the C library is glibc.

    By default it gives larger pieces back to the system at once, and each step of a detector then
    waits for empty pages: a tenth of its time.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            library = ctypes.CDLL(None)
            library.mallopt(MMAP_THRESHOLD, KEPT)
            library.mallopt(TRIM_THRESHOLD, KEPT)


def forget_peak() -> None:
    """Let the peak of memory begin anew, where the system (Linux) can."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_mebibytes() -> float:
    """The most memory that this process has held, since ``forget_peak`` where that works.

    Its own, not that of the process that started it. 0 where the system does not say (Windows).
    What getrusage tells (macOS) is at least what the parent held when it started this process.
    """
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) / 2**10
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2 ** (20 if sys.platform == "darwin" else 10)


def check_device(device: str, where: str) -> None:
    """Raises ConfigError, which names ``where``, for a device that torch or this machine lacks."""
    import torch

    try:
        kind = torch.device(device).type
    except RuntimeError:
        raise ConfigError(where, "is no device of torch", "give cpu, cuda or cuda:1") from None
    try:
        torch.zeros(1, device=device).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        problem = f"cannot be used: {str(error).splitlines()[0].rstrip('.')}"
        hint = "leave it out" if kind == "cuda" else "give cpu, cuda or cuda:1"
        raise ConfigError(where, problem, hint) from None
