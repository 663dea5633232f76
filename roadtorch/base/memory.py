"""Memory of this process: how much it held at most, and what it keeps when it has let go of it."""

import ctypes
import sys
from contextlib import suppress
from pathlib import Path

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3  # numbers of glibc's mallopt(3)

KEPT = 2**28
"""Bytes of freed memory that stay with the process at most; ours: fusion frees 30 MB a picture."""


def keep_freed_memory() -> None:
    """Let this process keep freed memory for the next picture, where the C library is glibc.

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
