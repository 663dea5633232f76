"""Workers: rows in order, whatever their number; a death costs what was in hand, and no more."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from roadtorch.runs.engines import MIN_PICTURES, processors, rows_of_workers, usual_workers
from roadtorch.runs.index import Row
from roadtorch.runs.pictures import Job
from roadtorch.sources.pictures import Picture

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are copies of a process")

JOBS = [Job(Picture(Path(f"in/{n}.png"), str(n)), Path("out"), ()) for n in range(30)]


def work(job: Job) -> Row:
    time.sleep(0.001 * (int(job.picture.name) % 3))
    return Row(job.file, width=str(os.getpid()))


def deadly_at_7(job: Job) -> Row:
    if job.picture.name == "7":
        os.kill(os.getpid(), signal.SIGKILL)
    return work(job)


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_rows_come_in_the_order_of_the_jobs_from_other_processes(workers: int) -> None:
    rows = list(rows_of_workers(JOBS, work, workers))

    assert [row.file for row in rows] == [job.file for job in JOBS]
    assert str(os.getpid()) not in {row.width for row in rows}
    assert len({row.width for row in rows}) <= workers


def test_a_worker_that_dies_costs_what_was_in_hand_and_others_go_on() -> None:
    rows = {row.file: row for row in rows_of_workers(JOBS, deadly_at_7, 2)}

    assert set(rows) == {job.file for job in JOBS}
    failed = {name for name, row in rows.items() if row.failed}
    assert "7.png" in failed
    assert len(failed) <= 3
    assert rows["7.png"].status.startswith("failed: in/7.png: a worker died")
    assert not rows["29.png"].failed


def test_closing_ends_the_workers() -> None:
    rows = rows_of_workers(JOBS, work, 2)
    worker = int(next(rows).width)

    rows.close()

    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)


def test_few_pictures_need_no_workers() -> None:
    assert usual_workers(1) == usual_workers(2 * MIN_PICTURES - 1) == 1
    assert usual_workers(10_000) == processors()
