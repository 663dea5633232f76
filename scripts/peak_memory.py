"""The most memory that a process has held: its own, not that of the process that started it."""

import resource
from contextlib import suppress
from pathlib import Path


def forget_peak() -> None:
    """Let the peak of memory begin anew, where the system (Linux) can."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_mebibytes() -> float:
    """The most memory that this process has held, since ``forget_peak`` where that works.

    What getrusage tells is at least what the parent held when it started this process.
    """
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) / 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
