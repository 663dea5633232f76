"""Parallel work by processes with one thread each; results come in the order of the items.

Processes rather than threads: half of the work on an image is Python's, between small steps of
torch, so that two threads of one process are hardly faster than one. Threads within an item stay
as they are set in this process, and with them every byte.
"""

import copyreg
import gc
import io
import os
import pickle
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from threading import Timer
from typing import Any, Protocol, TypeVar

import torch
from torch import Tensor

from roadtorch.base.compute import Threads, check_device, keep_freed_memory
from roadtorch.base.errors import InputError
from roadtorch.base.signals import SIGNALS, end_with_parent, interrupting_none_started

Given = TypeVar("Given")
Result = TypeVar("Result")

MIN_ITEMS = 4
"""Items a worker, from which making one pays; ours: it costs as much as one image."""

AHEAD = 2
"""Items a worker that may be done before the one that is next is; ours: images are uneven."""

PATIENCE = 10.0
"""Seconds that a worker gets to end what it has in hand, before it is killed."""

DIED = ("a worker died over it", "run it again; with less memory, --jobs 1")
"""What went wrong with an item over which a worker died, and what to do."""

# --- in order -----------------------------------------------------------------------------


class Pool(Protocol):
    """Workers that do one task. crashes: what a future raises where a worker died."""

    crashes: tuple[type[Exception], ...]

    def start(self) -> Any:
        """Return another worker; InputError where there can be none."""
        ...

    def submit(self, worker: Any, item: bytes) -> Future[bytes]:
        """Return the pickled result of the task on a pickled item."""
        ...

    def end(self, workers: Sequence[Any]) -> None:
        """End workers, within ``PATIENCE``."""
        ...


@dataclass(frozen=True)
class Workers:
    """Up to ``jobs`` processes of this machine, or workers of another pool; one: this process."""

    jobs: int = 1
    pool: Callable[[Callable[[Any], Any]], Pool] | None = None

    def map(
        self,
        task: Callable[[Given], Result],
        items: Iterable[Given],
        died: Callable[[Given], Result],
    ) -> Generator[Result]:
        """Yield the results of a task on all items, in their order, a few items ahead at most.

        died: gives the result of an item over which a worker died; others take its place. Task,
        items and results are pickled where another process does the work. Closing this ends it.
        InputError where a process cannot be started.
        """
        if self.pool is None and self.jobs == 1:
            return (task(item) for item in items)
        pool = _ProcessPool(task) if self.pool is None else self.pool(task)
        return _map_in_order(pool, self.jobs, iter(items), died)


def _map_in_order(
    pool: Pool, jobs: int, items: Iterator[Given], died: Callable[[Given], Result]
) -> Generator[Result]:
    """Yield the results of all items in their order; see ``Workers.map``.

    A worker has at most one item in hand, and its death costs that one. All workers are there
    before the first item is asked for: a copy of a process must not have what reading brings, such
    as a decoder's threads.
    """
    idle: list[Any] = []
    busy: dict[Future[bytes], Any] = {}
    pending: deque[tuple[Given, Future[bytes]]] = deque()
    is_over, error = False, None
    try:
        for _ in range(jobs):
            idle.append(pool.start())
        while True:
            while pending and pending[0][1].done():
                item, future = pending.popleft()
                is_crash = isinstance(future.exception(), pool.crashes)
                yield died(item) if is_crash else pickle.loads(future.result())
            if idle and len(pending) < AHEAD * jobs and not is_over:
                try:
                    item = next(items)
                except StopIteration:
                    is_over = True
                except Exception as raised:  # reported behind the results of what came before
                    is_over, error = True, raised
                else:
                    worker = idle.pop()
                    future = pool.submit(worker, pickled(item))
                    busy[future] = worker
                    pending.append((item, future))
            elif busy:
                for future in wait(busy, return_when=FIRST_COMPLETED).done:
                    worker = busy.pop(future)
                    if isinstance(future.exception(), pool.crashes):
                        pool.end([worker])
                        worker = pool.start()
                    idle.append(worker)
            elif error:
                raise error
            else:
                return
    finally:
        pool.end([*idle, *busy.values()])


def processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def workers_for(jobs: int | None, count: int | None = None, device: str = "cpu") -> Workers:
    """Return the workers for so many items (None: unknown) with ``--jobs``; None: what pays.

    That is one process a processor, none for a few items, and none beside a GPU.
    """
    if jobs is None:
        jobs = processors() if device == "cpu" else 1
        jobs = jobs if count is None else min(jobs, count // MIN_ITEMS)
    return Workers(max(jobs, 1))


def settle(threads: int, device: str = "cpu") -> None:
    """Set threads and memory; ConfigError for a device that torch or this machine lacks."""
    Threads(threads, threads).set()
    keep_freed_memory()
    check_device(device, f"--device {device}")


def pickled(value: object) -> bytes:
    """Return a value as bytes for another process, which ``pickle.loads`` reads.

    Tensors go as arrays, in a third of the time that torch takes for its own form of them.
    """
    data = io.BytesIO()
    pickler = pickle.Pickler(data, pickle.HIGHEST_PROTOCOL)
    pickler.dispatch_table = copyreg.dispatch_table | {torch.Tensor: _reduce_tensor}
    pickler.dump(value)
    return data.getvalue()


def _reduce_tensor(tensor: Tensor) -> Any:
    if tensor.is_contiguous():  # NumPy would change the order of others
        with suppress(TypeError, RuntimeError):  # of types that NumPy lacks; of what learns
            return torch.from_numpy, (tensor.numpy(),)
    return tensor.__reduce_ex__(pickle.HIGHEST_PROTOCOL)


# --- processes of this machine --------------------------------------------------------------

_task: Callable[[Any], Any] | None = None
"""What this process does, where it is a worker."""


class _ProcessPool:
    """Executors with one process each, so that it is known what that had in hand.

    Copies of this process, so that nothing is loaded twice, where it can be copied: on Linux, and
    without a GPU or several threads of OpenMP, which do not survive that.
    """

    crashes: tuple[type[Exception], ...] = (BrokenExecutor,)

    def __init__(self, task: Callable[[Any], Any]) -> None:
        self._threads = Threads.of_now()
        is_plain = self._threads.torch == 1 and not torch.cuda.is_initialized()
        is_copied = sys.platform == "linux" and is_plain
        self._context = get_context("fork" if is_copied else "spawn")
        self._inherited = task if is_copied else None
        # Bytes, because torch would share tensors between processes through sockets. They are sent
        # once the process runs: Python waits for ever for one that dies over its arguments.
        self._sent = None if is_copied else pickle.dumps(task, pickle.HIGHEST_PROTOCOL)
        self._processes: dict[ProcessPoolExecutor, set[BaseProcess]] = {}

    def start(self) -> ProcessPoolExecutor:
        """As ``Pool.start``."""
        earlier = set(active_children())
        try:
            arguments = (self._threads, self._inherited)
            executor = ProcessPoolExecutor(1, self._context, _become_worker, arguments)
            with interrupting_none_started():
                executor.submit(_load, self._sent)
        except (OSError, RuntimeError) as error:  # RuntimeError: of a thread that serves it
            for process in set(active_children()) - earlier:
                process.kill()
            problem = f"no process can be started: {getattr(error, 'strerror', None) or error}"
            raise InputError("--jobs", problem, "give --jobs 1, or end other programs") from None
        self._processes[executor] = set(active_children()) - earlier
        return executor

    def submit(self, worker: ProcessPoolExecutor, item: bytes) -> Future[bytes]:
        """As ``Pool.submit``."""
        try:
            return worker.submit(_work, item)
        except BrokenExecutor as error:  # it died with nothing in hand
            future = Future[bytes]()
            future.set_exception(error)
            return future

    def end(self, workers: Sequence[ProcessPoolExecutor]) -> None:
        """As ``Pool.end``."""
        processes = set[BaseProcess]().union(*(self._processes.pop(worker) for worker in workers))

        def kill() -> None:
            for process in processes:
                process.kill()

        timer = Timer(PATIENCE, kill)
        timer.start()
        try:
            for worker in workers:
                worker.shutdown(cancel_futures=True)
        finally:  # also where a second signal comes
            timer.cancel()
            kill()


def _become_worker(threads: Threads, task: Callable[[Any], Any] | None) -> None:
    """Prepare a process to do a task; signals are for the process that made this one."""
    global _task
    _task = task
    gc.freeze()  # nothing of the other process is ended here: its threads are not
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    end_with_parent()
    threads.set()
    keep_freed_memory()


def _load(task: bytes | None) -> None:
    """Take the task, unless this process is a copy that has it."""
    global _task
    if task is not None:
        _task = pickle.loads(task)


def _work(item: bytes) -> bytes:
    assert _task is not None
    return pickled(_task(pickle.loads(item)))
