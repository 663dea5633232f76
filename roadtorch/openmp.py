"""The threads of OpenMP, in which torch computes: how they wait, and when one is enough.

How they wait for one another is told when torch is loaded, or never.
"""

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import cache, wraps
from typing import ParamSpec, TypeVar

BRIEF_WAITS = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "2000"}
"""Threads that wait spin for some microseconds, then sleep. A detector has hundreds of short waits:
threads that sleep at once take twice as long on a quiet machine, and threads that spin for
milliseconds, as by default, many times as long on a busy one (docs/performance.md)."""

SMALL = 2**19
"""Pixels below which an image is worked on by one thread alone: a kernel on one is over in
microseconds, and others would have to be woken for each, or to wait where a machine is busy
(docs/performance.md)."""

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


def alone_if_small(function: Callable[P, Result]) -> Callable[P, Result]:
    """Mark a function or method of an image (…,H,W): one thread does it where that is ``SMALL``."""

    @wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> Result:
        shapes = (getattr(each, "shape", ()) for each in (*args, *kwargs.values()))
        height, width = next(shape for shape in shapes if shape)[-2:]
        with one_thread() if height * width < SMALL else nullcontext():
            return function(*args, **kwargs)

    return wrapped


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside the block, what this thread asks of torch is done by this thread alone.

    Every other thread keeps what it has. ``torch.set_num_threads`` would also hold for threads
    that begin meanwhile, and for them it would stay. Where the library that knows the number
    cannot be reached, nothing changes.
    """
    import torch  # whoever asks has loaded it; ``brief_waits`` comes before

    before, runtime = torch.get_num_threads(), _runtime()
    if before == 1 or runtime is None:
        yield
        return
    # MKL multiplies matrices, and has a number of its own where ``set_num_threads`` was called.
    of_products = getattr(runtime, "MKL_Set_Num_Threads_Local", lambda number: number)
    runtime.omp_set_num_threads(1)
    products = of_products(1)
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
