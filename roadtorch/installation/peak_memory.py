"""The most memory that a process has held: its own, not that of the process that started it."""

import sys
from contextlib import suppress
from pathlib import Path


def forget_peak() -> None:
    """Let the peak of memory begin anew, where the system (Linux) can."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_mebibytes() -> float:
    """The most memory that this process has held, since ``forget_peak`` where that works.

    0 where the system does not say (Windows). What getrusage tells (macOS) is at least what the
    parent held when it started this process.
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
