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
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from mmap import mmap
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.util import Finalize
from typing import Any, Protocol, TypeVar

import torch
from torch import Tensor

from roadtorch.base.compute import Threads, check_device, keep_freed_memory
from roadtorch.base.errors import InputError
from roadtorch.base.signals import STOP_SIGNALS, block_sigint_in_children, end_with_parent

_Memory = mmap | bytearray
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

MIN_ITEMS_PER_WORKER = 4
"""Fewest items for which a worker is started; ours: starting one takes as long as one image."""

MAX_AHEAD = 2
"""Most items a worker may finish ahead of the next result; ours: images take unequal times."""

SHARED_BYTES = 2**27
"""Address space for the arrays of an item, and for those of a result: an image of 4K fits."""

NO_MEMORY = memoryview(bytearray())
SHUTDOWN_TIMEOUT = 10.0  # seconds that a worker gets to finish its item, before it is killed

WORKER_CRASH = ("its worker process died", "run it again, with --jobs 1 if memory is short")
"""Problem and hint of an item whose worker process died."""


class WorkerCrashError(Exception):
    """A worker died during its item."""


class _Worker(Protocol):
    """A worker of one task; ``run`` raises WorkerCrashError where it died, ``stop`` ends it."""

    def run(self, item: object) -> Any: ...

    def stop(self) -> None: ...


TaskFunction = Callable[[Any], Any]
"""A function of an item; it is pickled for other processes."""


@dataclass(frozen=True)
class Workers:
    """Workers: ``jobs`` processes (one: this process itself), or what ``start`` makes for a task.

    A worker has at most one item, so that its death costs only that.
    """

    jobs: int = 1
    start: Callable[[TaskFunction], _Worker] | None = None

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
        if self.start is None and self.jobs == 1:
            yield from map(task, items)
            return
        pool = _Pool(partial(self.start or partial(_Process, Threads.current()), task), self.jobs)
        pending: deque[tuple[_Item, Future[_Result]]] = deque()
        errors: list[Exception] = []

        def read() -> Iterator[_Item]:
            try:
                yield from items
            except Exception as error:  # raised after the results of earlier items
                errors.append(error)

        def running() -> list[Future[_Result]]:
            return [future for _, future in pending if not future.done()]

        def take() -> _Result:
            item, future = pending.popleft()
            try:
                return future.result()
            except WorkerCrashError:
                return on_crash(item)

        try:
            pool.fill()  # before the first item is read: no process inherits a decoder's threads
            for item in read():
                pending.append((item, pool.submit(item)))
                while (live and pending and pending[0][1].done()) or (
                    len(running()) == self.jobs or len(pending) == MAX_AHEAD * self.jobs
                ):
                    if pending[0][1].done():
                        yield take()
                    else:
                        wait(running(), return_when=FIRST_COMPLETED)
            while pending:
                yield take()
            if errors:
                raise errors[0]
        finally:
            try:
                wait(running(), SHUTDOWN_TIMEOUT)
            finally:  # also after a second signal
                pool.stop()


class _Pool:
    """The workers of a task, with a thread each that waits for its result."""

    def __init__(self, start: Callable[[], _Worker], jobs: int) -> None:
        self._start, self._jobs, self._threads = start, jobs, ThreadPoolExecutor(jobs)
        self._workers, self._idle = list[_Worker](), list[_Worker]()

    def fill(self) -> None:
        with _report_start():
            self._idle += [self._add() for _ in range(self._jobs)]

    def submit(self, item: object) -> Future[Any]:
        with _report_start():
            worker = self._idle.pop() if self._idle else self._add()
            return self._threads.submit(self._run, worker, item)

    def stop(self) -> None:
        for worker in [*self._workers]:
            worker.stop()
        self._threads.shutdown(wait=False)

    def _add(self) -> _Worker:
        self._workers.append(self._start())
        return self._workers[-1]

    def _run(self, worker: _Worker, item: object) -> Any:
        try:
            return worker.run(item)
        except WorkerCrashError:
            worker.stop()
            self._workers.remove(worker)
            raise
        finally:
            self._idle.extend({worker}.intersection(self._workers))


@contextmanager
def _report_start() -> Iterator[None]:
    """Raise InputError where the block cannot start a process, or the thread that waits for it."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        problem = f"no process can be started: {getattr(error, 'strerror', None) or error}"
        raise InputError("--jobs", problem, "give --jobs 1, or end other programs") from None


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


def _reduce_tensor(tensor: Tensor) -> Any:
    if tensor.is_contiguous():  # NumPy would change the strides of other tensors
        with suppress(TypeError, RuntimeError):  # dtypes that NumPy lacks; tensors with gradients
            return torch.from_numpy, (tensor.numpy(),)
    return tensor.__reduce_ex__(pickle.HIGHEST_PROTOCOL)


# --- processes of this machine --------------------------------------------------------------


class _Process:
    """A process of this machine, with a pipe to it.

    It is forked, so that nothing is loaded twice, where that is safe: on Linux, without CUDA and
    without several OpenMP threads, neither of which survives a fork. It then shares memory,
    for an item and for its result: arrays pass through it in a fifth of a pipe's time.
    """

    def __init__(self, threads: Threads, task: TaskFunction) -> None:
        forks = sys.platform == "linux" and threads.torch == 1 and not torch.cuda.is_initialized()
        context = get_context("fork") if forks else get_context("spawn")
        self._memories = [mmap(-1, SHARED_BYTES) if forks else bytearray() for _ in range(2)]
        self._unsent_task, inherited_task = (None, task) if forks else (task, None)
        self._pipe, end = context.Pipe()
        arguments = (end, threads, inherited_task, self._memories)
        with end, _safe_path(), block_sigint_in_children():
            self._process = context.Process(target=_work, args=arguments)
            self._process.start()
        Finalize(self, self._process.kill, exitpriority=0)  # or Python waits for it at its own end

    def run(self, item: object) -> Any:
        """Return the result of an item: copies, as the memory is soon used again.

        A process that dies before it has its task raises InputError: all others would die as well.
        """
        try:
            if self._unsent_task is not None:
                # In bytes, because torch would share tensors between processes through sockets.
                # Python itself would wait forever for a process that dies reading its arguments.
                self._pipe.send(pickle_value(self._unsent_task))
                self._unsent_task = self._pipe.recv()
        except (EOFError, OSError):
            hint = "give --jobs 1, and check the Python environment of new processes"
            raise InputError("--jobs", "a worker process died at its start", hint) from None
        item_memory, result_memory = map(memoryview, self._memories)
        try:
            self._pipe.send(pickle_value(item, item_memory))
            is_error, data, places = self._pipe.recv()
        except (EOFError, OSError):
            raise WorkerCrashError from None
        value = pickle.loads(data, buffers=[bytearray(result_memory[place]) for place in places])
        if is_error:
            raise value
        return value

    def stop(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.join()


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


def _work(
    pipe: Connection, threads: Threads, task: TaskFunction | None, memories: Sequence[_Memory]
) -> None:
    """Run a task, inherited or sent first, on the items from a pipe.

    Stop signals are left to the parent process.
    """
    gc.freeze()  # no finalizer of the parent's objects may run here: its threads do not exist
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    end_with_parent()
    threads.set()
    keep_freed_memory()
    item_memory, result_memory = map(memoryview, memories)
    if task is None:
        task = pickle.loads(pipe.recv()[0])
        pipe.send(None)  # it has its task
    assert task is not None
    with suppress(EOFError, OSError):  # the parent process has ended
        while True:
            data, places = pipe.recv()
            try:
                item = pickle.loads(data, buffers=[item_memory[place] for place in places])
                result = (False, *pickle_value(task(item), result_memory))
            except Exception as error:
                result = (True, *pickle_value(error))
            pipe.send(result)
