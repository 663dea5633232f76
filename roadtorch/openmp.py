"""How the threads of OpenMP wait for one another: it is told when torch is loaded, or never."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

BRIEF_WAITS = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "2000"}
"""Threads that wait spin for some microseconds, then sleep. A detector has hundreds of short waits:
threads that sleep at once take twice as long on a quiet machine, and threads that spin for
milliseconds, as by default, many times as long on a busy one (docs/performance.md)."""

TOLD_BY = (*BRIEF_WAITS, "KMP_BLOCKTIME")
"""The variables by which somebody may have said how threads wait."""


def unless_told() -> dict[str, str]:
    """``BRIEF_WAITS``, or nothing where the environment says how threads wait."""
    return {} if any(name in os.environ for name in TOLD_BY) else BRIEF_WAITS


@contextmanager
def brief_waits() -> Iterator[None]:
    """Let the threads of torch wait briefly, if the block is what loads it.

    Whoever has loaded torch before, or has set one of the variables, has settled it; the
    environment is afterwards as it was, for children too.
    """
    told = {} if "torch" in sys.modules else unless_told()
    os.environ.update(told)
    try:
        yield
    finally:
        for name in told:
            os.environ.pop(name, None)
