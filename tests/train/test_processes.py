"""Processes that train together: what they add up, gather, and leave behind."""

import sys
from pathlib import Path

import pytest

from roadtorch.train.processes import Processes, join_processes
from tests.train.runs import run, torchrun

MEMBER = """
import os, torch
from roadtorch.train.processes import join_processes

with join_processes() as processes:
    weight = torch.nn.Parameter(torch.ones(3))
    optimiser = torch.optim.SGD([weight], 0.1)
    (weight * (processes.rank + 1)).sum().backward()
    added, ranks = processes.add(weight.grad).tolist(), processes.gather(processes.rank)
    asked = processes.any(processes.rank == 1)
    optimiser.step()
tasks = os.listdir("/proc/self/task")
threads = [open(f"/proc/self/task/{task}/comm").read().strip() for task in tasks]
with open(f"member{processes.rank}", "w") as file:
    print(added, ranks, asked, processes.share(list("abc")), sep="; ", file=file)
    print([thread for thread in threads if "gloo" in thread], file=file)
"""


def test_alone_there_is_nothing_to_add(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)

    with join_processes() as processes:
        assert processes == Processes(0, 1)
        assert processes.leads
        assert processes.gather("a") == ["a"]
        assert list(processes.share("abc")) == ["a", "b", "c"]


@pytest.mark.skipif(sys.platform != "linux", reason="threads are read from /proc")
def test_two_add_gather_and_leave_no_thread_behind(tmp_path: Path) -> None:
    """Threads of gloo that outlive the processes crash one run in thirty as it ends."""
    (tmp_path / "member.py").write_text(MEMBER)

    done = run([*torchrun(2), "member.py"], tmp_path)

    assert done.returncode == 0, done.stderr
    told = [(tmp_path / f"member{rank}").read_text().splitlines() for rank in range(2)]
    assert told == [
        ["[3.0, 3.0, 3.0]; [0, 1]; True; ['a', 'c']", "[]"],
        ["[3.0, 3.0, 3.0]; [0, 1]; True; ['b']", "[]"],
    ]
