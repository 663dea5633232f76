"""Work side by side: processes with one thread each, results in the order of the items.

Processes, which Python's lock does not keep waiting for one another: half of the work on a picture
is Python's, between small steps of torch, so that two threads of one process are hardly faster than
one. Threads within an item stay as they are set in this process, and with them every byte.
"""

import gc
import io
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Protocol, TypeVar

import torch

from roadtorch.base.device import check_device
from roadtorch.base.errors import InputError
from roadtorch.base.memory import keep_freed_memory
from roadtorch.base.signals import SIGNALS, end_with_parent, interrupting_none_started
from roadtorch.base.threads import Threads

Given = TypeVar("Given")
Result = TypeVar("Result")

MIN_ITEMS = 4
"""Items a worker, from which making one pays; ours: it costs as much as one picture."""

AHEAD = 2
"""Items a worker that may be done before the one that is next is; ours: pictures are uneven."""

PATIENCE = 10.0
"""Seconds that a worker gets to end what it has in hand, before it is killed."""

DIED = ("a worker died over it", "run it again; with less memory, --jobs 1")
"""What went wrong with an item over which a worker died, and what to do."""


class Workers(Protocol):
    """Who does the work of a command."""

    def map(
        self,
        task: Callable[[Given], Result],
        items: Iterable[Given],
        died: Callable[[Given], Result],
    ) -> Generator[Result]:
        """The results of a task on all items, in their order, a few items ahead at most.

        died: gives the result of an item over which a worker died; others take its place. Task,
        items and results are pickled where another process does the work. Closing this ends it.
        """
        ...


class ThisProcess:
    """Who works where nothing is done side by side: this process, one item after the other."""

    def map(
        self,
        task: Callable[[Given], Result],
        items: Iterable[Given],
        died: Callable[[Given], Result],
    ) -> Generator[Result]:
        """As ``Workers.map``."""
        for item in items:
            yield task(item)


@dataclass(frozen=True)
class Processes:
    """Up to ``jobs`` processes of this machine, made when there is work for them."""

    jobs: int

    def map(
        self,
        task: Callable[[Given], Result],
        items: Iterable[Given],
        died: Callable[[Given], Result],
    ) -> Generator[Result]:
        """As ``Workers.map``; InputError where not one process can be made."""
        return ordered(_Team(task), self.jobs, items, died)


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def workers_for(jobs: int | None, count: int | None = None, device: str = "cpu") -> Workers:
    """Who works on so many items (None: nobody knows) with ``--jobs``; None: what pays.

    That is one process a processor, none for a few items, and none beside a GPU.
    """
    if jobs is None:
        jobs = processors() if device == "cpu" else 1
        jobs = jobs if count is None else min(jobs, count // MIN_ITEMS)
    return Processes(jobs) if jobs > 1 else ThisProcess()


def settle(threads: int, device: str = "cpu") -> None:
    """Set threads and memory; ConfigError for a device that torch or this machine lacks."""
    Threads(threads, threads).set()
    keep_freed_memory()
    check_device(device, f"--device {device}")


# --- in order -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Raised:
    """What a worker sends where its task raised; an exception that a task returns is a result."""

    problem: Exception


ARRAYS = {torch.float32, torch.float64, torch.uint8, torch.int32, torch.int64, torch.bool}
"""Types of tensors that go to other processes as arrays."""


class _Pickler(pickle.Pickler):
    """Tensors as arrays, in a third of the time that torch takes for its own form of them."""

    def reducer_override(self, value: Any) -> Any:
        if type(value) is not torch.Tensor or value.dtype not in ARRAYS or value.requires_grad:
            return NotImplemented
        if value.device.type != "cpu" or not value.is_contiguous():
            return NotImplemented
        return torch.from_numpy, (value.numpy(),)


def pickled(value: object) -> bytes:
    """A value as bytes for another process, which ``pickle.loads`` reads."""
    data = io.BytesIO()
    _Pickler(data, pickle.HIGHEST_PROTOCOL).dump(value)
    return data.getvalue()


def worked(task: Callable[[Any], Any], data: bytes) -> bytes:
    """The pickled result of a task on a pickled item, or what it ``Raised``."""
    try:
        result = task(pickle.loads(data))
    except Exception as problem:
        result = Raised(problem)
    return pickled(result)


class Team(Protocol):
    """Workers of one kind, each with at most one item in hand."""

    def hire(self) -> Any:
        """Another worker; OSError where there can be none."""
        ...

    def send(self, worker: Any, data: bytes) -> None:
        """Hand over a pickled item; OSError where the worker is dead."""
        ...

    def ready(self, busy: Sequence[Any], seconds: float | None) -> Sequence[Any]:
        """Those that are done, or dead; without ``seconds`` there is one."""
        ...

    def receive(self, worker: Any) -> bytes:
        """What ``worked`` gave there; EOFError where the worker is dead."""
        ...

    def dismiss(self, workers: Sequence[Any]) -> None:
        """End them, within ``PATIENCE``."""
        ...


class _Pass(Generic[Given, Result]):
    """One pass over items: who has which in hand, and results that wait for earlier ones.

    All workers are there before the first item is asked for: a copy of a process must not have what
    reading brings, such as a decoder's threads.
    """

    def __init__(
        self, team: Team, jobs: int, items: Iterable[Given], died: Callable[[Given], Result]
    ) -> None:
        self.team, self.items, self.died = team, iter(items), died
        self.idle: list[Any] = []
        self.busy: dict[Any, tuple[int, Given]] = {}
        self.results: dict[int, Result] = {}
        self.sent = self.given = 0
        self.is_over = False
        self.problem: Exception | None = None
        while len(self.idle) < jobs and self.hire():
            pass

    def hire(self) -> bool:
        """Whether there is another worker; where not, those that are there have to do."""
        try:
            self.idle.append(self.team.hire())
            return True
        except OSError as problem:
            if not self.idle and not self.busy:
                what = f"no process can be started: {problem.strerror or problem}"
                remedy = "give --jobs 1, or end other programs"
                raise InputError("--jobs", what, remedy) from None
            return False

    def lose(self, worker: Any, number: int, item: Given) -> None:
        """Have another worker in the place of one that died over an item."""
        self.team.dismiss([worker])
        self.results[number] = self.died(item)
        if not self.is_over:
            self.hire()

    def feed(self) -> None:
        """Hand items to workers that have none, as far ahead as may be."""
        most = self.given + AHEAD * (len(self.idle) + len(self.busy))
        while self.idle and self.sent < most and not self.is_over:
            try:
                item = next(self.items)
            except StopIteration:
                self.is_over = True
                return
            except Exception as problem:  # of the source: raised behind what it gave before
                self.is_over, self.problem = True, problem
                return
            number, worker = self.sent, self.idle.pop()
            self.sent += 1
            self.busy[worker] = number, item
            try:
                self.team.send(worker, pickled(item))
            except OSError:
                del self.busy[worker]
                self.lose(worker, number, item)

    def collect(self, seconds: float | None) -> None:
        """Take the results of workers that are done."""
        for worker in self.team.ready(list(self.busy), seconds):
            number, item = self.busy.pop(worker)
            try:
                result = pickle.loads(self.team.receive(worker))
            except (EOFError, OSError):
                self.lose(worker, number, item)
                continue
            if isinstance(result, Raised):
                raise result.problem
            self.results[number] = result
            self.idle.append(worker)


def ordered(
    team: Team, jobs: int, items: Iterable[Given], died: Callable[[Given], Result]
) -> Generator[Result]:
    """The results of all items in their order; see ``Workers.map``."""
    state = _Pass(team, jobs, items, died)
    try:
        while True:
            state.feed()
            is_next_there = state.given in state.results
            if state.busy:
                state.collect(0 if is_next_there else None)
                state.feed()
            elif not is_next_there:
                if state.problem:
                    raise state.problem
                return
            if state.given in state.results:
                result = state.results.pop(state.given)
                state.given += 1
                yield result
    finally:
        team.dismiss([*state.idle, *state.busy])


# --- processes of this machine --------------------------------------------------------------


@dataclass(frozen=True)
class _Worker:
    process: Any
    connection: Connection

    def __hash__(self) -> int:
        return id(self)


class _Team:
    """Processes that were made to do one task.

    Copies of this process, so that nothing is loaded twice, where it can be copied: on Linux, and
    without a GPU or several threads of OpenMP, which do not survive that.
    """

    def __init__(self, task: Callable[[Any], Any]) -> None:
        self._threads = Threads.of_now()
        is_plain = self._threads.torch == 1 and not torch.cuda.is_initialized()
        is_copied = sys.platform == "linux" and is_plain
        self._context: Any = get_context("fork" if is_copied else "spawn")
        # Bytes, because torch would share tensors between processes through sockets.
        self._task = task if is_copied else pickle.dumps(task, pickle.HIGHEST_PROTOCOL)
        self._is_copied = is_copied
        self._connections: list[Connection] = []

    def hire(self) -> _Worker:
        own, theirs = self._context.Pipe()
        self._connections = [other for other in self._connections if not other.closed]
        # A copy has this process's ends of all connections, too: open there, they never end.
        self._connections.append(own)
        copied = self._connections if self._is_copied else []
        try:
            with closing(theirs), interrupting_none_started():
                arguments = (theirs, copied, self._task, self._threads)
                process = self._context.Process(target=_serve, args=arguments, daemon=True)
                process.start()
        except OSError:
            own.close()
            raise
        return _Worker(process, own)

    def send(self, worker: _Worker, data: bytes) -> None:
        worker.connection.send_bytes(data)

    def ready(self, busy: Sequence[_Worker], seconds: float | None) -> Sequence[_Worker]:
        done = wait([worker.connection for worker in busy], seconds)
        return [worker for worker in busy if worker.connection in done]

    def receive(self, worker: _Worker) -> bytes:
        return worker.connection.recv_bytes()

    def dismiss(self, workers: Sequence[_Worker]) -> None:
        for worker in workers:
            worker.connection.close()
        end = time.monotonic() + PATIENCE
        for worker in workers:
            worker.process.join(max(0.0, end - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()


def _serve(
    connection: Connection, copied: Sequence[Connection], task: Any, threads: Threads
) -> None:
    """Be a worker until nobody sends items; signals are for the process that made this one.

    copied: connections of that process, of which this one has copies.
    """
    for other in copied:
        other.close()
    gc.freeze()  # nothing of the other process is ended here: its threads are not
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    end_with_parent()
    threads.set()
    keep_freed_memory()
    work = pickle.loads(task) if isinstance(task, bytes) else task
    with suppress(EOFError, OSError):
        while True:
            connection.send_bytes(worked(work, connection.recv_bytes()))
