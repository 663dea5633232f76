"""Workers of this machine: processes, which Python's lock does not keep waiting for one another.

Half of the work on a picture is Python's, between small steps of torch, so that two threads of
one process are hardly faster than one. Each worker is a copy of this process, made when the work
is ready, so that nothing is loaded twice; threads within a picture stay as they were set, and
with them every byte.
"""

import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_all_start_methods, get_context
from typing import Any

from roadtorch.runs.batch import Rows, Task, Work
from roadtorch.runs.index import FAILED, Row
from roadtorch.runtime.signals import SIGNALS, end_with_parent

FEWEST = 4
"""Pictures a worker, from which making one pays; ours: it costs as much as one picture."""


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def usual_workers(tasks: int) -> int:
    """How many workers so many pictures get where nobody says: one a processor, if that pays.

    One where a process cannot be copied (Windows, macOS): starting a new one takes seconds.
    """
    if "fork" not in get_all_start_methods() or os.uname().sysname != "Linux":
        return 1
    return max(1, min(processors(), tasks // FEWEST))


def rows_of_workers(tasks: Sequence[Task], work: Work, workers: int) -> Rows:
    """The rows of all tasks in their order, a few tasks ahead at most; an ``Engine``.

    What a worker that dies (killed, out of memory) had in hand becomes a failed row, and others
    take its place. Closing this waits for what is in hand.
    """
    left = deque(tasks)
    while left:
        with _pool(work, workers) as pool:
            yield from _until_broken(pool, left, workers)


@contextmanager
def _pool(work: Work, workers: int) -> Iterator[ProcessPoolExecutor]:
    context = get_context("fork")
    pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(work,))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _until_broken(pool: ProcessPoolExecutor, left: deque[Task], workers: int) -> Rows:
    """The rows of the tasks left, until one of the workers dies."""
    waiting: deque[tuple[Task, Future[Row]]] = deque()
    while left or waiting:
        try:
            while left and len(waiting) <= workers:
                waiting.append((left[0], pool.submit(_do, left[0])))
                left.popleft()
            future = waiting[0][1]
            row = future.result()
        except BrokenProcessPool:
            yield from (_lost(task, future) for task, future in waiting)
            return
        waiting.popleft()
        yield row


def _lost(task: Task, future: Future[Row]) -> Row:
    """The row of a task that was in hand when a worker died."""
    if future.done() and not future.cancelled() and future.exception() is None:
        return future.result()
    what = "a worker died over it or over its neighbour (run it again; with less memory, --jobs 1)"
    return Row(task.file, status=f"{FAILED}: {task.origin}: {what}")


# --- in a worker ------------------------------------------------------------------------

_WORK: list[Work] = []  # of this worker; a pool hands it over only once, and not to the tasks


def _begin(work: Work) -> None:
    """Be a worker: signals are for the process that made this one, and without it there is none."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    _WORK[:] = [work]
    end_with_parent()


def _do(task: Any) -> Row:
    return _WORK[0](task)
