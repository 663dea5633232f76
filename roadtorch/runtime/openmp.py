"""The threads of OpenMP, in which torch computes: how they wait, and how many there should be.

How they wait for one another is told when torch is loaded, or never.
"""

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

BRIEF_WAITS = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "20000"}
"""Threads that wait spin for about a millisecond, then sleep. A detector has hundreds of short
waits: threads that sleep sooner take longer on a quiet machine, and threads that spin fifteen times
as long, as by default, on a busy one (docs/performance.md)."""

LOAD, OWN_THREADS = Path("/proc/loadavg"), Path("/proc/self/task")
"""Where Linux tells how many threads run, on the machine and of this process."""

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


P = ParamSpec("P")

Result = TypeVar("Result")


def considerate(function: Callable[P, Result]) -> Callable[P, Result]:
    """Mark a function that computes with torch: it takes no more threads than there are free cores.

    Threads of OpenMP wait for one another at the end of every kernel. Where one of them has to wait
    for a core that other work holds, all do, a thousand times in a picture.
    """

    @wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> Result:
        import torch

        if torch.get_num_threads() == 1:
            return function(*args, **kwargs)
        with at_most(free_cores()):
            return function(*args, **kwargs)

    return wrapped


def free_cores() -> int:
    """Cores that no other process holds at this moment, one at least; all where nobody tells."""
    try:
        running = int(LOAD.read_text().split()[3].partition("/")[0])
        cores = len(os.sched_getaffinity(0))
    except (AttributeError, IndexError, OSError, ValueError):  # other systems than Linux
        return os.cpu_count() or 1
    return max(1, cores - (running - _own_running() if running > 1 else 0))


def _own_running() -> int:
    """Threads of this process that run or wait for a core: those without work spin for a while."""
    running = 0
    for thread in os.listdir(OWN_THREADS):
        with suppress(OSError), open(f"{OWN_THREADS}/{thread}/stat", "rb") as told:  # it may end
            running += told.read().rpartition(b")")[2][:3] == b" R "
    return running


@contextmanager
def at_most(threads: int) -> Iterator[None]:
    """Inside the block, what this thread asks of torch is done by at most so many threads.

    Every other thread of the program keeps what it has. ``torch.set_num_threads`` would also hold
    for threads that begin meanwhile, and for them it would stay. Where the library that knows
    the number cannot be reached, nothing changes.
    """
    import torch  # whoever asks has loaded it; ``brief_waits`` comes before

    before, runtime = torch.get_num_threads(), _runtime()
    if before <= threads or runtime is None:
        yield
        return
    # MKL multiplies matrices, and has a number of its own where ``set_num_threads`` was called.
    of_products = getattr(runtime, "MKL_Set_Num_Threads_Local", lambda number: number)
    runtime.omp_set_num_threads(threads)
    products = of_products(threads)
    try:
        yield
    finally:
        of_products(products)
        runtime.omp_set_num_threads(before)


@cache
def _runtime() -> ctypes.CDLL | None:
    """What torch is linked with, OpenMP among it; None where that cannot be had."""
    import torch

    try:
        library = ctypes.CDLL(torch._C.__file__)
        library.omp_set_num_threads.restype = None
    except (OSError, AttributeError):
        return None
    return library
