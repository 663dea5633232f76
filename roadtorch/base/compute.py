"""Computing resources of a process: threads of torch and OpenCV, memory, torch devices."""

import ctypes
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from roadtorch.base.errors import ConfigError

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8  # numbers of glibc's mallopt(3)

MAX_KEPT_BYTES = 2**28
"""Freed memory that the process keeps, at most; ours: fusion frees 30 MB an image."""

_THREAD_COUNT_LOCK = Lock()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch compute in the calling thread inside the block, or in the decorated function.

    The same image then gives the same bytes: sums that threads share depend on their number.
    Other threads keep their number throughout. New tensors are on the CPU (``default_to_cpu``).
    """
    import torch

    with _THREAD_COUNT_LOCK:  # a new thread takes the default, which another may be changing
        count = torch.get_num_threads()
    if count == 1:
        with default_to_cpu():
            yield
        return
    _set_calling_thread_count(1)
    try:
        with default_to_cpu():
            yield
    finally:
        _set_calling_thread_count(count)


@contextmanager
def default_to_cpu() -> Iterator[None]:
    """Make new tensors on the CPU inside the block, whatever ``torch.set_default_device`` says."""
    import torch

    is_cpu = torch.empty(0).device.type == "cpu"
    with nullcontext() if is_cpu else torch.device("cpu"):
        yield


def _set_calling_thread_count(count: int) -> None:
    """Set torch's number of threads for the calling thread alone.

    ``torch.set_num_threads`` also sets the default of new threads: another new thread looks that
    up first and restores it.
    """
    import torch

    with _THREAD_COUNT_LOCK, ThreadPoolExecutor(1) as new:
        default = new.submit(torch.get_num_threads).result()
        torch.set_num_threads(count)
        new.submit(torch.set_num_threads, default).result()


@dataclass(frozen=True)
class Threads:
    """Numbers of threads that torch and OpenCV use within one image."""

    torch: int
    opencv: int

    @classmethod
    def current(cls) -> "Threads":
        """Return the numbers of this process."""
        import cv2
        import torch

        return cls(torch.get_num_threads(), cv2.getNumThreads())

    def set(self) -> None:
        """Set the numbers of this process."""
        import cv2
        import torch

        torch.set_num_threads(self.torch)
        cv2.setNumThreads(self.opencv)


@contextmanager
def single_threaded_process() -> Iterator[None]:
    """Limit torch and OpenCV to one thread in this process, and in copies of it, in the block."""
    previous = Threads.current()
    Threads(1, 1).set()
    try:
        yield
    finally:
        previous.set()


# --- memory and device ------------------------------------------------------------------


def keep_freed_memory() -> None:
    """Make glibc keep freed memory for the next image, if it is the C library.

    By default it returns larger pieces to the system at once, and each step of a detector then
    waits for empty pages: a tenth of its time. Threads share one arena: others shrink at once.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            library = ctypes.CDLL(None)
            library.mallopt(MMAP_THRESHOLD, MAX_KEPT_BYTES)
            library.mallopt(TRIM_THRESHOLD, MAX_KEPT_BYTES)
            library.mallopt(ARENA_MAX, 1)


def peak_memory_mib() -> float:
    """Return the peak memory of this process in MiB.

    0 on Windows. On macOS (getrusage) it is at least what the parent process held when it started
    this one.
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
    """Raise ConfigError at ``where`` if torch or this machine lacks a device."""
    import torch

    try:
        device_type = torch.device(device).type
    except (RuntimeError, TypeError):
        raise ConfigError(where, "is no torch device", "give cpu, cuda or cuda:1") from None
    try:
        torch.zeros(1, device=device).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        problem = f"cannot be used: {str(error).splitlines()[0].rstrip('.')}"
        hint = "leave it out" if device_type == "cuda" else "give cpu, cuda or cuda:1"
        raise ConfigError(where, problem, hint) from None
