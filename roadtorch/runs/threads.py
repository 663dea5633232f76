"""Threads and memory of a command's process.

Likelihoods depend on the number of threads, in the seventh digit.
"""

import ctypes
import sys
from contextlib import suppress
from dataclasses import dataclass


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
