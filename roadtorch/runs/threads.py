"""Threads of a command's process."""

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
