"""The machine and the interpreter: what a report of a fault begins with."""

import os
import platform
from pathlib import Path

from roadtorch.installation.check import Check
from roadtorch.version import __version__


def check_machine() -> list[Check]:
    """roadtorch, Python, the system, its processors and its memory."""
    root = Path(__file__).parents[2]
    origin = "a checkout" if (root / "pyproject.toml").is_file() else "an installed package"
    memory = memory_bytes()
    gib = f"{memory / 2**30:.1f} GiB" if memory else "unknown"
    return [
        Check("roadtorch", "ok", f"{__version__}, {origin}"),
        Check("python", "ok", f"{platform.python_version()}, {platform.python_implementation()}"),
        Check("system", "ok", f"{platform.system()} {platform.release()}, {platform.machine()}"),
        Check("memory", "ok", gib, figures={"bytes": memory}),
        *check_threads(),
    ]


def check_threads() -> list[Check]:
    """The processors that this process may use, and the threads that torch and OpenCV take."""
    import cv2
    import torch

    figures = {
        "processors": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1,
        "torch": torch.get_num_threads(),
        "opencv": cv2.getNumThreads(),
    }
    told = ", ".join(f"{name} {count}" for name, count in figures.items())
    limit = os.environ.get("OMP_NUM_THREADS")
    return [
        Check("threads", "ok", told + (f", OMP_NUM_THREADS {limit}" if limit else ""), "", figures)
    ]


def memory_bytes() -> int:
    """Of the machine; 0 where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0
