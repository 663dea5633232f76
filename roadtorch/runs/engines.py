"""Who does the jobs of a run: threads of this process, copies of it, or actors on Ray."""

import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_all_start_methods, get_context

import torch

from roadtorch.errors import ConfigError
from roadtorch.runs.index import FAILED, Row
from roadtorch.runs.options import ComputeOptions
from roadtorch.runs.pictures import Engine, Job, Rows, Work
from roadtorch.runtime.memory import keep_freed_memory
from roadtorch.runtime.signals import SIGNALS, end_with_parent
from roadtorch.runtime.threads import Threads

MIN_PICTURES = 4
"""Pictures a worker, from which making one pays; ours: it costs as much as one picture."""


def prepare(compute: ComputeOptions) -> None:
    """Set threads and memory; ConfigError for a device that torch or this machine lacks."""
    Threads(compute.threads, compute.threads).set()
    keep_freed_memory()
    name = compute.device
    try:
        kind = torch.device(name).type
    except RuntimeError:
        raise ConfigError(
            f"--device {name}", "is no device of torch", "give cpu, cuda or cuda:1"
        ) from None
    try:
        torch.zeros(1, device=name).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as problem:
        why = str(problem).splitlines()[0].rstrip(".")
        what = f"cannot be used: {why}"
        remedy = "leave --device out" if kind == "cuda" else "give cpu, cuda or cuda:1"
        raise ConfigError(f"--device {name}", what, remedy) from None


@contextmanager
def started_engine(compute: ComputeOptions, pictures: int) -> Iterator[Engine | None]:
    """The engine that was asked for so many pictures, for the block; None: this process itself.

    Raises ConfigError where Ray is not there, or ``--address`` is given without it.
    """
    if not pictures:
        yield None
        return
    if compute.engine == "local":
        if compute.address is not None:
            what = "is for Ray alone"
            raise ConfigError("--address", what, "add --engine ray, or leave it out")
        workers = compute.jobs or usual_workers(pictures)
        # A process that has used a GPU, or several threads of OpenMP, is not to be copied.
        is_plain = compute.device == "cpu" and compute.threads == 1
        yield partial(rows_of_workers, workers=workers) if is_plain and workers > 1 else None
        return
    from roadtorch.runs.ray_engine import ray_engine

    with ray_engine(compute) as engine:
        yield engine


# --- workers of this machine ------------------------------------------------------------
#
# Processes, which Python's lock does not keep waiting for one another: half of the work on a
# picture is Python's, between small steps of torch, so that two threads of one process are hardly
# faster than one. Each is a copy of this process, made when the work is ready, so that nothing is
# loaded twice; threads within a picture stay as they were set, and with them every byte.


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def usual_workers(pictures: int) -> int:
    """How many workers so many pictures get where nobody says: one a processor, if that pays.

    One where a process cannot be copied (Windows, macOS): starting a new one takes seconds.
    """
    if "fork" not in get_all_start_methods() or os.uname().sysname != "Linux":
        return 1
    return max(1, min(processors(), pictures // MIN_PICTURES))


def rows_of_workers(jobs: Sequence[Job], work: Work, workers: int) -> Rows:
    """The rows of all jobs in their order, a few ahead at most; an ``Engine``.

    What a worker that dies (killed, out of memory) had in hand becomes a failed row, and others
    take its place. Closing this waits for what is in hand.
    """
    left = deque(jobs)
    while left:
        context = get_context("fork")
        pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(work,))
        try:
            yield from _until_broken(pool, left, workers)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _until_broken(pool: ProcessPoolExecutor, left: deque[Job], workers: int) -> Rows:
    """The rows of the jobs left, until one of the workers dies."""
    waiting: deque[tuple[Job, Future[Row]]] = deque()
    while left or waiting:
        try:
            while left and len(waiting) <= workers:
                waiting.append((left[0], pool.submit(_do, left[0])))
                left.popleft()
            row = waiting[0][1].result()
        except BrokenProcessPool:
            for job, future in waiting:
                if future.done() and not future.cancelled() and future.exception() is None:
                    yield future.result()
                else:
                    what = "a worker died over it or over its neighbour"
                    what += " (run it again; with less memory, --jobs 1)"
                    yield Row(job.file, status=f"{FAILED}: {job.origin}: {what}")
            return
        waiting.popleft()
        yield row


_WORK: list[Work] = []  # of this worker; a pool hands it over only once, and not to the jobs


def _begin(work: Work) -> None:
    """Be a worker: signals are for the process that made this one, and without it there is none."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    _WORK[:] = [work]
    end_with_parent()


def _do(job: Job) -> Row:
    return _WORK[0](job)
