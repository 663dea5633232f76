"""Workers: results in order, whatever their number; a death costs one item, and is made up for."""

import os
import pickle
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial

import pytest
import torch

from roadtorch.base.errors import InputError
from roadtorch.base.threads import Threads
from roadtorch.run import workers
from roadtorch.run.workers import (
    AHEAD,
    MIN_ITEMS,
    Processes,
    ThisProcess,
    processors,
    workers_for,
)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are copies of a process")

Result = tuple[int, int]
"""The number of an item, and the process that had it; 0 where that died."""


def work(number: int) -> Result:
    time.sleep(0.002 * (number % 3))
    return number, os.getpid()


def deadly(number: int, at: tuple[int, ...]) -> Result:
    if number in at:
        os.kill(os.getpid(), signal.SIGKILL)
    return work(number)


def died(number: int) -> Result:
    return number, 0


def limit_hires(monkeypatch: pytest.MonkeyPatch, most: int) -> list[int]:
    """Let the system have no processes after so many; those that were asked for are noted."""
    hire, asked = workers._Team.hire, []

    def limited(self: workers._Team) -> workers._Worker:
        asked.append(len(asked))
        if len(asked) > most:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        return hire(self)

    monkeypatch.setattr(workers._Team, "hire", limited)
    return asked


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_results_come_in_the_order_of_the_items_from_other_processes(jobs: int) -> None:
    results = list(Processes(jobs).map(work, range(30), died))

    assert [number for number, _ in results] == [*range(30)]
    makers = {process for _, process in results}
    assert 0 < len(makers) <= jobs
    assert not makers & {os.getpid(), 0}


def test_this_process_does_one_item_after_the_other() -> None:
    items = iter(range(5))
    results = ThisProcess().map(work, items, died)

    assert next(results) == (0, os.getpid())
    assert list(items) == [1, 2, 3, 4]


@pytest.mark.parametrize("at", [(0,), (7,), (29,), (3, 4, 5, 20)])
def test_a_death_costs_exactly_the_item_in_hand(at: tuple[int, ...]) -> None:
    results = list(Processes(2).map(partial(deadly, at=at), range(30), died))

    assert [number for number, _ in results] == [*range(30)]
    assert tuple(number for number, process in results if not process) == at


def test_reading_ahead_is_bounded() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            yield number

    with closing(Processes(2).map(work, items(), died)) as results:
        for count, _ in enumerate(results, 1):
            assert len(taken) <= count + AHEAD * 2
            if count == 9:
                break


def test_what_a_task_raises_is_raised_and_an_exception_that_it_returns_is_a_result() -> None:
    returned = list(Processes(2).map(ValueError, ["a", "b"], ValueError))
    assert [str(problem) for problem in returned] == ["a", "b"]
    with pytest.raises(ZeroDivisionError):
        list(Processes(2).map(partial(divmod, 1), [2, 1, 0, 3], lambda _: (0, 0)))


def test_closing_ends_the_workers_at_once() -> None:
    results = Processes(3).map(work, range(30), died)
    makers = {next(results)[1] for _ in range(6)}
    start = time.monotonic()

    results.close()

    assert time.monotonic() - start < workers.PATIENCE / 2
    for process in makers:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


@pytest.mark.parametrize("most", [1, 2])
def test_where_no_more_processes_can_be_made_fewer_do_the_work(
    monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    asked = limit_hires(monkeypatch, most)

    results = list(Processes(4).map(work, range(12), died))

    assert [number for number, _ in results] == [*range(12)]
    assert len({process for _, process in results}) <= most
    assert len(asked) == most + 1  # it is not tried again and again


def test_where_not_one_process_can_be_made_it_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    limit_hires(monkeypatch, 0)

    with pytest.raises(InputError) as caught:
        list(Processes(4).map(work, range(12), died))

    assert str(caught.value) == (
        "--jobs: no process can be started: Resource temporarily unavailable "
        "(give --jobs 1, or end other programs)"
    )


def test_where_the_last_worker_died_and_there_is_no_other_it_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limit_hires(monkeypatch, 1)
    results = Processes(1).map(partial(deadly, at=(2,)), range(5), died)

    assert [next(results)[0] for _ in range(2)] == [0, 1]
    with pytest.raises(InputError, match="no process can be started"):
        list(results)


def multiplied(number: int, factor: torch.Tensor) -> tuple[float, int]:
    return float(factor * number), torch.get_num_threads()


def test_beside_several_threads_workers_are_started_anew_with_as_many() -> None:
    before = Threads.of_now()
    task = partial(multiplied, factor=torch.tensor(2.0))
    try:
        Threads(2, 1).set()
        results = list(Processes(1).map(task, range(3), lambda _: (0.0, 0)))
    finally:
        before.set()

    assert results == [(0.0, 2), (2.0, 2), (4.0, 2)]


@pytest.mark.parametrize(
    ("jobs", "count", "device", "expected"),
    [
        (1, None, "cpu", 1),
        (3, 1, "cpu", 3),
        (None, 2 * MIN_ITEMS - 1, "cpu", 1),
        (None, 10_000, "cpu", processors()),
        (None, None, "cpu", processors()),
        (None, None, "cuda", 1),
    ],
)
def test_workers_are_as_many_as_pay(
    jobs: int | None, count: int | None, device: str, expected: int
) -> None:
    made = workers_for(jobs, count, device)

    assert made == Processes(expected) if expected > 1 else isinstance(made, ThisProcess)


def failing_behind(count: int) -> Iterator[int]:
    yield from range(count)
    raise InputError("drive.mp4", "ends early", "copy it again")


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_what_ends_the_items_is_raised_behind_the_results_of_those_before(jobs: int) -> None:
    results = workers_for(jobs).map(work, failing_behind(7), died)

    numbers = [next(results)[0] for _ in range(7)]

    assert numbers == [*range(7)]
    with pytest.raises(InputError, match="ends early"):
        next(results)


@pytest.mark.parametrize(
    "tensor",
    [
        torch.rand(3, 4, 5),
        torch.rand(4, 5).T,
        torch.arange(6) > 2,
        torch.rand(2).to(torch.bfloat16),
        torch.rand(2, requires_grad=True),
        torch.tensor(0.5),
    ],
    ids=["image", "turned", "mask", "half", "learning", "number"],
)
def test_tensors_reach_another_process_as_they_are(tensor: torch.Tensor) -> None:
    copy = pickle.loads(workers.pickled(("name", tensor)))[1]

    assert torch.equal(copy, tensor)
    assert (copy.dtype, copy.stride()) == (tensor.dtype, tensor.stride())
    assert copy.requires_grad == tensor.requires_grad
    copy.detach().zero_()  # it is nobody else's
    assert not torch.equal(copy, tensor)
