"""Parallel work in processes; results come in the order of the items.

Processes rather than threads: half of the time on an image is spent in Python, between small steps
of torch, so that two threads of one process are hardly faster than one. Each worker has the number
of torch threads of this process, so that results are the same to the byte.
"""

import gc
import io
import os
import pickle
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from mmap import mmap
from multiprocessing import connection, get_context
from multiprocessing.util import Finalize
from time import monotonic
from typing import Any, TypeVar

import torch

from roadtorch.base.compute import Threads, check_device, keep_freed_memory
from roadtorch.base.errors import InputError
from roadtorch.base.signals import STOP_SIGNALS, block_sigint_in_children, end_with_parent

_Memory = mmap | bytearray | memoryview
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

TaskFunction = Callable[[Any], Any]
"""A function of an item; it is pickled for other processes."""


class WorkerCrashError(Exception):
    """A worker died during its item."""


@dataclass(frozen=True)
class Workers:
    """Workers: ``jobs`` processes (one: this process itself).

    A worker has at most one item, so that its death costs only that.
    """

    jobs: int = 1

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
        if self.jobs == 1:
            yield from map(task, items)
            return
        items, end = iter(items), None
        stopping, idle = ExitStack(), list[_Process]()
        busy = dict[Any, tuple[_Item, Future[_Result]]]()  # by worker
        pending: deque[Future[_Result]] = deque()

        def start() -> _Process:
            worker = _Process(task)
            stopping.callback(worker.stop)
            return worker

        def collect(timeout: float | None = None) -> None:
            ready: list[Any] = connection.wait([*busy], timeout)
            for worker in ready:
                item, future = busy.pop(worker)
                try:
                    future.set_result(worker.receive())
                except WorkerCrashError:
                    future.set_result(on_crash(item))
                    worker.stop()
                    continue
                except Exception as error:
                    future.set_exception(error)
                idle.append(worker)

        try:
            # Before the first item is read: no process inherits a decoder's threads.
            idle += [start() for _ in range(self.jobs)]
            while pending or end is None:
                collect(0)
                is_full = len(busy) == self.jobs or len(pending) == MAX_AHEAD * self.jobs
                if pending and pending[0].done() and (live or is_full or end):
                    yield pending.popleft().result()
                elif is_full or end:
                    collect()
                else:
                    try:
                        item = next(items)
                    except Exception as error:  # StopIteration, or raised after earlier results
                        end = error
                        continue
                    worker = idle.pop() if idle else start()
                    worker.send(item)
                    pending.append(Future())
                    busy[worker] = item, pending[-1]
            if not isinstance(end, StopIteration):
                raise end
        finally:
            latest = monotonic() + SHUTDOWN_TIMEOUT
            with stopping:  # also after a second signal
                while busy and monotonic() < latest:
                    collect(latest - monotonic())


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


def configure_threads(device: str = "cpu") -> None:
    """Give torch and OpenCV one thread, set malloc; ConfigError for an unavailable device."""
    Threads(1, 1).set()
    keep_freed_memory()
    check_device(device, f"--device {device}")


# --- processes of this machine --------------------------------------------------------------


class _Pickler(pickle.Pickler):
    """A pickler of tensors as NumPy arrays, in a third of torch's time."""

    def reducer_override(self, value: Any) -> Any:
        # NumPy would change the strides of tensors that are not contiguous.
        if type(value) is torch.Tensor and value.is_contiguous():
            with suppress(TypeError, RuntimeError):  # dtypes that NumPy lacks; with gradients
                return torch.from_numpy, (value.numpy(),)
        return NotImplemented


def pickle_value(value: object, memory: _Memory = NO_MEMORY) -> tuple[bytes, list[slice]]:
    """Return a pickled value, and the places in ``memory`` of its arrays that fit there."""
    data, places = io.BytesIO(), list[slice]()

    def is_in_pickle(array: pickle.PickleBuffer) -> bool:
        start = -(-places[-1].stop // 64) * 64 if places else 0
        place = slice(start, start + array.raw().nbytes)
        if place.stop > len(memory):
            return True
        places.append(place)
        memory[place] = array.raw()
        return False

    _Pickler(data, pickle.HIGHEST_PROTOCOL, buffer_callback=is_in_pickle).dump(value)
    return data.getvalue(), places


class _Process:
    """A process of this machine, with a pipe to it.

    It is forked, so that nothing is loaded twice, where that is safe: on Linux, without CUDA and
    without several OpenMP threads, neither of which survives a fork. It then shares memory,
    for an item and for its result: arrays pass through it in a fifth of a pipe's time.
    """

    def __init__(self, task: TaskFunction) -> None:
        threads = Threads.current()
        forks = sys.platform == "linux" and threads.torch == 1 and not torch.cuda.is_initialized()
        context = get_context("fork") if forks else get_context("spawn")
        self._memories = [mmap(-1, SHARED_BYTES) if forks else bytearray() for _ in range(2)]
        self._unsent_task = None if forks else task
        self._pipe, end = context.Pipe()
        arguments = (end, threads, task if forks else None, *self._memories)
        try:
            with end, _safe_path(), block_sigint_in_children():
                self._process = context.Process(target=_work, args=arguments)
                self._process.start()
        except OSError as error:
            problem = f"no process can be started: {error.strerror}"
            raise InputError("--jobs", problem, "give --jobs 1, or end other programs") from None
        Finalize(self, self._process.kill, exitpriority=0)  # or Python waits for it at its own end
        self.fileno = self._pipe.fileno

    def send(self, item: object) -> None:
        """Send an item, after the task to a new process that did not inherit it."""
        with suppress(EOFError, OSError):  # it has died: ``receive`` reports that
            if self._unsent_task is not None:
                # In bytes, because torch would share tensors between processes through sockets.
                # Python itself would wait forever for a process that dies reading its arguments.
                self._pipe.send(pickle_value(self._unsent_task))
                self._unsent_task = self._pipe.recv()
            self._pipe.send(pickle_value(item, self._memories[0]))

    def receive(self) -> Any:
        """Return the result of the item: copies, as the memory is soon used again.

        A process that dies before it has its task raises InputError: all others would die as well.
        """
        try:
            is_error, data, places = self._pipe.recv()
        except (EOFError, OSError):
            if self._unsent_task is None:
                raise WorkerCrashError from None
            hint = "give --jobs 1, and check the Python environment of new processes"
            raise InputError("--jobs", "a worker process died at its start", hint) from None
        value = pickle.loads(data, buffers=[bytearray(self._memories[1][p]) for p in places])
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
    pipe: connection.Connection,
    threads: Threads,
    task: TaskFunction | None,
    *memories: _Memory,
) -> None:
    """Run a task, inherited or sent first, on the items from a pipe; ignore stop signals."""
    gc.freeze()  # no finalizer of the parent's objects may run here: its threads do not exist
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    end_with_parent()
    threads.set()
    keep_freed_memory()
    items, results = map(memoryview, memories)
    with suppress(EOFError, OSError):  # the parent process has ended
        if task is None:
            task = pickle.loads(pipe.recv()[0])
            pipe.send(None)  # it has its task
        assert task is not None
        while True:
            data, places = pipe.recv()
            try:
                item = pickle.loads(data, buffers=[items[place] for place in places])
                answer = (False, *pickle_value(task(item), results))
            except Exception as error:
                answer = (True, *pickle_value(error))
            pipe.send(answer)
