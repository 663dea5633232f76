"""Workers: results in order, and crashes that cost one item each."""

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch

from roadtorch.base.compute import Threads
from roadtorch.base.errors import InputError
from roadtorch.run import workers
from roadtorch.run.workers import (
    MAX_AHEAD,
    MIN_ITEMS_PER_WORKER,
    Workers,
    count_processors,
    make_workers,
)
from tests.command import ROWS, save_image

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are copies of a process")

Result = tuple[int, int]  # number of an item and its process, 0 where that died


def work(number: int, deadly: tuple[int, ...] = ()) -> Result:
    if number in deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.002 * (number % 3))
    return number, os.getpid()


def died(number: int) -> Result:
    return number, 0


@pytest.mark.parametrize(("jobs", "pause"), [(1, 0), (2, 0), (3, 0), (2, 0.01)])
def test_results_come_in_the_order_of_items_from_other_processes(jobs: int, pause: float) -> None:
    results: list[Result] = []
    for result in Workers(jobs).map(work, range(30), died):
        time.sleep(pause)
        results.append(result)

    assert [number for number, _ in results] == [*range(30)]
    makers = {process for _, process in results}
    assert 0 < len(makers) <= jobs
    assert (makers == {os.getpid()}) if jobs == 1 else not makers & {os.getpid(), 0}


@pytest.mark.parametrize("deadly", [(), (0,), (29,), (3, 4, 5, 20)])
def test_a_death_costs_exactly_the_item_in_hand(deadly: tuple[int, ...]) -> None:
    def items() -> Iterator[int]:
        if not deadly:  # a worker without an item: the first one that it gets
            multiprocessing.active_children()[0].kill()
        yield from range(30)

    results = list(Workers(2).map(partial(work, deadly=deadly), items(), died))

    dead = tuple(number for number, process in results if not process)
    assert [number for number, _ in results] == [*range(30)]
    assert dead == deadly if deadly else len(dead) == 1


def test_reading_ahead_is_bounded() -> None:
    read: list[int] = []

    def items() -> Iterator[int]:
        for number in range(100):
            read.append(number)
            yield number

    with closing(Workers(2).map(work, items(), died)) as results:
        for count, _ in enumerate(results, 1):
            assert len(read) <= count + MAX_AHEAD * 2
            if count == 9:
                break


class InlineWorker:
    """A worker whose result is there at once."""

    def __init__(self, task: Callable[[Any], Any]) -> None:
        self.task = self.receive = task

    def send(self, item: object) -> None:
        self.receive = partial(self.task, item)

    def stop(self) -> None: ...


@pytest.mark.parametrize(("live", "ahead"), [(True, 1), (False, MAX_AHEAD * 2)])
def test_results_of_a_live_source_come_before_its_next_item(
    live: bool, ahead: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "_Process", InlineWorker)
    monkeypatch.setattr(workers.connection, "wait", lambda busy, _: busy)
    items = iter(range(9))

    results = Workers(2).map(abs, items, abs, live)

    assert [next(results) for _ in range(3)] == [0, 1, 2]
    assert next(items) == 2 + ahead


def failing_behind(count: int) -> Iterator[int]:
    yield from range(count)
    raise InputError("drive.mp4", "ends early", "copy it again")


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_what_a_task_or_the_items_raise_is_raised_behind_the_results_before(jobs: int) -> None:
    returned = list(Workers(jobs).map(ValueError, ["a", "b"], ValueError))
    of_task = Workers(jobs).map(partial(divmod, 1), [2, 1, 0, 3], lambda _: (0, 0))
    of_items = Workers(jobs).map(work, failing_behind(7), died)

    assert [str(error) for error in returned] == ["a", "b"]
    assert [next(of_task) for _ in range(2)] == [(0, 1), (1, 0)]
    with pytest.raises(ZeroDivisionError):
        next(of_task)
    assert [next(of_items)[0] for _ in range(7)] == [*range(7)]
    with pytest.raises(InputError, match="ends early"):
        next(of_items)


def test_closing_ends_the_workers_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "SHUTDOWN_TIMEOUT", 600)
    results = Workers(3).map(work, range(30), died)
    makers = {next(results)[1] for _ in range(6)}
    start = time.monotonic()

    results.close()

    assert time.monotonic() - start < 300
    for process in makers:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_a_worker_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "SHUTDOWN_TIMEOUT", 0.1)
    results = Workers(2).map(time.sleep, [0, 6000, 6000], lambda _: None)
    next(results)
    start = time.monotonic()

    results.close()

    assert time.monotonic() - start < 600


def test_no_process_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BaseProcess, "start", Mock(side_effect=BlockingIOError(11, "try again")))

    with pytest.raises(InputError, match=r"^--jobs: no process can be started: try again \("):
        list(Workers(4).map(work, range(12), died))


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Give torch two threads: workers are started anew."""
    threads = Threads.current()
    Threads(2, 1).set()
    yield
    threads.set()


def multiplied(number: int, factor: torch.Tensor) -> tuple[float, int]:
    return float(factor * number), torch.get_num_threads()


@pytest.mark.usefixtures("two_threads")
def test_beside_several_threads_workers_are_started_anew_with_as_many() -> None:
    task = partial(multiplied, factor=torch.tensor(2.0))

    results = list(Workers(2).map(task, range(3), lambda _: (0.0, 0)))

    assert results == [(0.0, 2), (2.0, 2), (4.0, 2)]


@pytest.mark.usefixtures("two_threads")
def test_workers_that_die_at_their_start_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "types.py").write_text("raise SystemExit('broken')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # of new processes alone

    with pytest.raises(InputError, match="--jobs: a worker process died at its start"):
        list(Workers(2).map(partial(work, deadly=(0,) * 10**6), range(30), died))

    assert "broken" in capfd.readouterr().err


def test_a_users_file_is_no_module_of_workers_that_are_started_anew(tmp_path: Path) -> None:
    (tmp_path / "types.py").write_text("x = 1  # notes\n")
    for name in "ab":
        save_image(tmp_path / f"{name}.jpg")
    code = "import sys; sys.path.remove(''); import torch; from roadtorch.run import workers; "
    code += "workers.configure_threads = lambda device: torch.set_num_threads(2); "  # no fork then
    code += "from roadtorch.cli import main; main()"
    words = ["infer", ".", *ROWS, "--out", "out", "--jobs=2", "--quiet"]

    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)

    assert (done.returncode, done.stderr) == (0, "")
    assert len(list((tmp_path / "out").glob("*.mask.png"))) == 2


@pytest.mark.parametrize(
    ("jobs", "count", "device", "expected"),
    [
        (1, None, "cpu", 1),
        (3, 1, "cpu", 3),
        (None, 2 * MIN_ITEMS_PER_WORKER - 1, "cpu", 1),
        (None, 10_000, "cpu", count_processors()),
        (None, None, "cpu", count_processors()),
        (None, None, "cuda", 1),
    ],
)
def test_how_many_workers(jobs: int | None, count: int | None, device: str, expected: int) -> None:
    assert make_workers(jobs, count, device) == Workers(expected)


@pytest.mark.parametrize(
    "tensor",
    [
        torch.rand(3, 4, 5),
        torch.rand(4, 5).T,
        torch.arange(6) > 2,
        torch.rand(2).to(torch.bfloat16),
        torch.rand(2, requires_grad=True),
        torch.tensor(0.5),
        torch.rand(0, 3),
    ],
    ids=["image", "turned", "mask", "half", "learning", "number", "none"],
)
@pytest.mark.parametrize("room", [0, 100, 10**6])
def test_tensors_reach_another_process_as_they_are(tensor: torch.Tensor, room: int) -> None:
    memory = memoryview(bytearray(room))

    data, places = workers.pickle_value(("name", tensor, tensor), memory)
    _, first, copy = pickle.loads(data, buffers=[memory[place] for place in places])

    assert all(place.stop <= room for place in places)
    assert torch.equal(first, tensor)
    assert torch.equal(copy, tensor)
    assert (copy.dtype, copy.stride()) == (tensor.dtype, tensor.stride())
    assert copy.requires_grad == tensor.requires_grad
    copy.detach().zero_()  # it is nobody else's
    assert not tensor.numel() or not torch.equal(copy, tensor)


def add_up(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.cumsum(0)


@pytest.mark.parametrize("shared", [workers.SHARED_BYTES, 4096])
def test_results_stay_as_they_are_while_workers_go_on(
    shared: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "SHARED_BYTES", shared)
    items = [torch.full((1000,), float(number)) for number in range(12)]

    results = list(Workers(2).map(add_up, items, add_up))

    assert all(
        torch.equal(result, add_up(item)) for result, item in zip(results, items, strict=True)
    )
