"""Workers: rows in order, whatever their number; a death costs what was in hand, and no more."""

import os
import signal
import sys
import time
from dataclasses import dataclass

import pytest

from roadtorch.runs.engines import MIN_PICTURES, processors, rows_of_workers, usual_workers
from roadtorch.runs.index import Row

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are copies of a process")


@dataclass(frozen=True)
class Number:
    """A task that is a number; ``deadly`` kills the worker that does it."""

    value: int
    deadly: bool = False

    @property
    def file(self) -> str:
        return f"{self.value}.png"

    @property
    def origin(self) -> str:
        return f"in/{self.value}.png"

    @property
    def is_complete(self) -> bool:
        return False

    def has_all(self, row: Row) -> bool:
        return False

    def digest(self) -> str:
        return ""


def work(task: Number) -> Row:
    if task.deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.001 * (task.value % 3))
    return Row(task.file, width=str(os.getpid()))


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_rows_come_in_the_order_of_the_tasks_from_other_processes(workers: int) -> None:
    tasks = [Number(value) for value in range(20)]

    rows = list(rows_of_workers(tasks, work, workers))

    assert [row.file for row in rows] == [task.file for task in tasks]
    assert str(os.getpid()) not in {row.width for row in rows}
    assert len({row.width for row in rows}) <= workers


def test_a_worker_that_dies_costs_what_was_in_hand_and_others_go_on() -> None:
    tasks = [Number(value, deadly=value == 7) for value in range(30)]

    rows = {row.file: row for row in rows_of_workers(tasks, work, 2)}

    assert set(rows) == {task.file for task in tasks}
    failed = {name for name, row in rows.items() if row.failed}
    assert "7.png" in failed
    assert len(failed) <= 3
    assert rows["7.png"].status.startswith("failed: in/7.png: a worker died")
    assert not rows["29.png"].failed


def test_closing_ends_the_workers() -> None:
    rows = rows_of_workers([Number(value) for value in range(50)], work, 2)
    worker = int(next(rows).width)

    rows.close()

    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)


def test_few_pictures_need_no_workers() -> None:
    assert usual_workers(1) == usual_workers(2 * MIN_PICTURES - 1) == 1
    assert usual_workers(10_000) == processors()
