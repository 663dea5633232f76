"""How the threads of OpenMP wait for one another: it is told when torch is loaded, or never."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

WAIT_POLICY = "OMP_WAIT_POLICY"
TOLD_BY = (WAIT_POLICY, "GOMP_SPINCOUNT", "KMP_BLOCKTIME")
"""The variables by which somebody may have said how threads wait."""


@contextmanager
def sleeping_threads() -> Iterator[None]:
    """Let the threads of torch sleep while they wait, if the block is what loads it.

    By default they spin, and where other processes have the cores too, a detector is thirty times
    slower (docs/performance.md). Whoever has loaded torch before, or has set one of the variables,
    has settled it; the environment is afterwards as it was, for children too.
    """
    if "torch" in sys.modules or any(name in os.environ for name in TOLD_BY):
        yield
        return
    os.environ[WAIT_POLICY] = "passive"
    try:
        yield
    finally:
        os.environ.pop(WAIT_POLICY, None)
