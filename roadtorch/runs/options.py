"""What a user may say of how a run computes and which frames it looks at."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ComputeOptions:
    """With what the pictures of a run are worked on.

    jobs: pictures at a time on this machine; None for one a processor. engine: ``local`` or
    ``ray``. address: of a Ray cluster; None for one of this machine. workers: actors. threads: of
    torch and OpenCV within a picture. device: of torch. fail_fast: end at the first failure.
    """

    jobs: int | None
    engine: str
    address: str | None
    workers: int
    threads: int
    device: str
    fail_fast: bool


@dataclass(frozen=True)
class FrameSelection:
    """Which frames and pictures of the inputs are looked at.

    every, start, end, limit: see ``roadtorch.sources.frame.Selection``. topic: of bags. patience:
    seconds within which a stream has to answer.
    """

    every: int
    start: float
    end: float | None
    limit: int | None
    topic: str | None
    patience: float
