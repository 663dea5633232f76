"""Parallel work in processes; results come in the order of the items.

Processes rather than threads: half of the time on an image is spent in Python, between small steps
of torch, so that two threads of one process are hardly faster than one. Each worker has the number
of torch threads of this process, so that results are the same to the byte.
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
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from mmap import mmap
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from threading import Timer
from typing import Any, Protocol, TypeVar

import torch
from torch import Tensor

from roadtorch.base.compute import Threads, check_device, keep_freed_memory
from roadtorch.base.errors import InputError
from roadtorch.base.signals import STOP_SIGNALS, block_sigint_in_children, end_with_parent

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

MIN_ITEMS_PER_WORKER = 4
"""Fewest items for which a worker is started; ours: starting one takes as long as one image."""

MAX_AHEAD = 2
"""Most items a worker may finish ahead of the next result; ours: images take unequal times."""

SHARED_BYTES = 2**27
"""Address space for the arrays of an item, and for those of a result: an image of 4K fits."""

NO_MEMORY = memoryview(b"")
SHUTDOWN_TIMEOUT = 10.0  # seconds that a worker gets to finish its item, before it is killed

WORKER_CRASH = ("its worker process died", "run it again, with --jobs 1 if memory is short")
"""Problem and hint of an item whose worker process died."""

# --- in order -----------------------------------------------------------------------------


class Pool(Protocol):
    """Workers for one task. crashes: exceptions of a future whose worker died."""

    crashes: tuple[type[Exception], ...]

    def start(self) -> Any:
        """Start a worker; InputError where that is impossible."""
        ...

    def submit(self, worker: Any, item: object) -> Future[Any]:
        """Send an item to a worker without one; the future holds the result."""
        ...

    def stop(self, workers: Sequence[Any]) -> None:
        """Stop workers within ``SHUTDOWN_TIMEOUT``."""
        ...


@dataclass(frozen=True)
class Workers:
    """Up to ``jobs`` processes (one: this process itself), or workers of another pool."""

    jobs: int = 1
    pool: Callable[[Callable[[Any], Any]], Pool] | None = None

    def map(
        self,
        task: Callable[[_Item], _Result],
        items: Iterable[_Item],
        on_crash: Callable[[_Item], _Result],
        live: bool = False,
    ) -> Generator[_Result]:
        """Yield the results of a task on all items, in their order, a few items ahead at most.

        on_crash: returns the result of an item whose worker died; the worker is replaced. live:
        whether results are yielded before the next item is waited for. Task, items and results are
        pickled for other processes. Closing the generator stops the workers. Raises InputError
        where a process cannot be started.
        """
        if self.pool is None and self.jobs == 1:
            return (task(item) for item in items)
        pool = _ProcessPool(task) if self.pool is None else self.pool(task)
        return _map_in_order(pool, self.jobs, iter(items), on_crash, live)


def _map_in_order(
    pool: Pool,
    jobs: int,
    items: Iterator[_Item],
    on_crash: Callable[[_Item], _Result],
    live: bool,
) -> Generator[_Result]:
    """Yield the results of all items in their order; see ``Workers.map``.

    A worker has at most one item, so that its death costs only that item. All workers start before
    the first item is read: a forked process must not inherit, say, a decoder's threads.
    """
    idle: list[Any] = []
    busy: dict[Future[Any], Any] = {}
    pending: deque[tuple[_Item, Future[Any]]] = deque()
    is_over, error = False, None
    try:
        for _ in range(jobs):
            idle.append(pool.start())
        while True:
            for future in [future for future in busy if future.done()]:
                worker = busy.pop(future)
                if isinstance(future.exception(), pool.crashes):
                    pool.stop([worker])
                    worker = pool.start()
                idle.append(worker)
            is_next = idle and len(pending) < MAX_AHEAD * jobs and not is_over
            if pending and pending[0][1].done() and (live or not is_next):
                item, future = pending.popleft()
                is_crash = isinstance(future.exception(), pool.crashes)
                yield on_crash(item) if is_crash else future.result()
            elif is_next:
                try:
                    item = next(items)
                except StopIteration:
                    is_over = True
                except Exception as raised:  # re-raised after the results of earlier items
                    is_over, error = True, raised
                else:
                    worker = idle.pop()
                    future = pool.submit(worker, item)
                    busy[future] = worker
                    pending.append((item, future))
            elif busy:
                wait(busy, return_when=FIRST_COMPLETED)
            elif error:
                raise error
            else:
                return
    finally:
        pool.stop([*idle, *busy.values()])


def count_processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def make_workers(jobs: int | None, count: int | None = None, device: str = "cpu") -> Workers:
    """Return workers for ``count`` items (None: unknown) and ``--jobs``.

    Without ``--jobs``: one process per processor, and only this process for few items or a GPU.
    """
    if jobs is None:
        jobs = count_processors() if device == "cpu" else 1
        jobs = jobs if count is None else min(jobs, count // MIN_ITEMS_PER_WORKER)
    return Workers(max(jobs, 1))


def configure_threads(threads: int, device: str = "cpu") -> None:
    """Set the threads of torch and OpenCV, and malloc; ConfigError for an unavailable device."""
    Threads(threads, threads).set()
    keep_freed_memory()
    check_device(device, f"--device {device}")


def pickle_value(value: object, memory: memoryview = NO_MEMORY) -> tuple[bytes, list[slice]]:
    """Return a pickled value, and the places in ``memory`` of those of its arrays that fit there.

    Tensors are pickled as NumPy arrays, in a third of torch's time.
    """
    data, places = io.BytesIO(), list[slice]()

    def is_in_pickle(array: pickle.PickleBuffer) -> bool:
        start = -(-places[-1].stop // 64) * 64 if places else 0
        place = slice(start, start + array.raw().nbytes)
        if place.stop > len(memory):
            return True
        places.append(place)
        memory[place] = array.raw()
        return False

    pickler = pickle.Pickler(data, pickle.HIGHEST_PROTOCOL, buffer_callback=is_in_pickle)
    pickler.dispatch_table = copyreg.dispatch_table | {torch.Tensor: _reduce_tensor}
    pickler.dump(value)
    return data.getvalue(), places


def convert_result(future: Future[Any], convert: Callable[[Any], Any]) -> Future[Any]:
    """Return a future of another one's converted result, or of its error."""
    converted = Future[Any]()

    def finish(done: Future[Any]) -> None:
        try:
            converted.set_result(convert(done.result()))
        except BaseException as error:
            converted.set_exception(error)

    future.add_done_callback(finish)
    return converted


def _reduce_tensor(tensor: Tensor) -> Any:
    if tensor.is_contiguous():  # NumPy would change the strides of other tensors
        with suppress(TypeError, RuntimeError):  # dtypes that NumPy lacks; tensors with gradients
            return torch.from_numpy, (tensor.numpy(),)
    return tensor.__reduce_ex__(pickle.HIGHEST_PROTOCOL)


# --- processes of this machine --------------------------------------------------------------

_task: Callable[[Any], Any] | None = None  # task of this process, where it is a worker
_memory: mmap | bytes = b""  # shared with its parent, half for an item, half for its result


def _halves(memory: mmap | bytes) -> tuple[memoryview, memoryview]:
    return memoryview(memory)[:SHARED_BYTES], memoryview(memory)[SHARED_BYTES:]


class _ProcessPool:
    """Executors with one process each, so that the item of a dead process is known.

    Processes are forked, so that nothing is loaded twice, where that is safe: on Linux, without
    CUDA and without several OpenMP threads, neither of which survives a fork. They share memory
    with this process: arrays pass through it in a fifth of the time that a pipe takes. A process
    that dies before it has its task ends the run: all after it would die as well.
    """

    crashes: tuple[type[Exception], ...] = (BrokenExecutor,)

    def __init__(self, task: Callable[[Any], Any]) -> None:
        self._threads = Threads.current()
        is_plain = self._threads.torch == 1 and not torch.cuda.is_initialized()
        self._forks = forks = sys.platform == "linux" and is_plain
        self._context = get_context("fork" if forks else "spawn")
        self._inherited_task = task if forks else None
        # Bytes, because torch would share tensors between processes through sockets. They are sent
        # once the process runs: Python waits forever for one that dies reading its arguments.
        self._pickled_task = None if forks else pickle.dumps(task, pickle.HIGHEST_PROTOCOL)
        self._processes: dict[ProcessPoolExecutor, set[BaseProcess]] = {}
        self._memories: dict[ProcessPoolExecutor, mmap | bytes] = {}
        self._starts: dict[ProcessPoolExecutor, Future[None]] = {}
        self._dies_at_start = False

    def start(self) -> ProcessPoolExecutor:
        """Start an executor with one process."""
        if self._dies_at_start:
            hint = "give --jobs 1, and check the Python environment of new processes"
            raise InputError("--jobs", "a worker process died at its start", hint)
        earlier = set(active_children())
        try:
            memory = mmap(-1, 2 * SHARED_BYTES) if self._forks else b""
            arguments = (self._threads, self._inherited_task, memory)
            with _safe_path(), block_sigint_in_children():
                executor = ProcessPoolExecutor(1, self._context, _initialise_worker, arguments)
                start = executor.submit(_load_task, self._pickled_task)
        except (OSError, RuntimeError) as error:  # RuntimeError: its thread cannot start
            for process in set(active_children()) - earlier:
                process.kill()
            problem = f"no process can be started: {getattr(error, 'strerror', None) or error}"
            raise InputError("--jobs", problem, "give --jobs 1, or end other programs") from None
        self._processes[executor] = set(active_children()) - earlier
        self._starts[executor], self._memories[executor] = start, memory
        return executor

    def submit(self, worker: ProcessPoolExecutor, item: object) -> Future[Any]:
        """Send an item to an executor; its result is copied, as the memory is soon used again."""
        item_memory, result_memory = _halves(self._memories[worker])
        try:
            future = worker.submit(_run_task, *pickle_value(item, item_memory))
        except BrokenExecutor as error:  # the process died without an item
            future = Future[Any]()
            future.set_exception(error)

        def load_copy(result: tuple[bytes, list[slice]]) -> Any:
            arrays = [bytearray(result_memory[place]) for place in result[1]]
            return pickle.loads(result[0], buffers=arrays)

        return convert_result(future, load_copy)

    def stop(self, workers: Sequence[ProcessPoolExecutor]) -> None:
        """Shut executors down, and kill processes that take too long."""
        processes = set[BaseProcess]().union(*(self._processes.pop(worker) for worker in workers))
        starts = [start for worker in workers if (start := self._starts.pop(worker)).done()]
        self._memories = {worker: self._memories[worker] for worker in self._starts}
        self._dies_at_start = any(isinstance(start.exception(), self.crashes) for start in starts)

        def kill() -> None:
            for process in processes:
                process.kill()

        timer = Timer(SHUTDOWN_TIMEOUT, kill)
        timer.start()
        try:
            for worker in workers:
                worker.shutdown(cancel_futures=True)
        finally:  # also after a second signal
            timer.cancel()
            kill()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let a Python that starts in the block import no types.py from the user's folder."""
    previous = os.environ.copy()
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        del os.environ["PYTHONSAFEPATH"]
        os.environ.update(previous)


def _initialise_worker(
    threads: Threads, task: Callable[[Any], Any] | None, memory: mmap | bytes
) -> None:
    """Prepare a worker process for its task; stop signals are left to the parent process."""
    global _task, _memory
    _task, _memory = task, memory
    gc.freeze()  # no finalizer of the parent's objects may run here: its threads do not exist
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    end_with_parent()
    threads.set()
    keep_freed_memory()


def _load_task(task: bytes | None) -> None:
    """Load the task, unless it was inherited from the parent process."""
    global _task
    if task is not None:
        _task = pickle.loads(task)


def _run_task(data: bytes, places: list[slice]) -> tuple[bytes, list[slice]]:
    assert _task is not None
    item_memory, result_memory = _halves(_memory)
    item = pickle.loads(data, buffers=[item_memory[place] for place in places])
    return pickle_value(_task(item), result_memory)
