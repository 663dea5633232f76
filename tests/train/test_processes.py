"""Processes that train together: what they add up, gather, learn and leave behind."""

import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
import torch

from roadtorch.errors import InputError
from roadtorch.layout.weights import load_network
from roadtorch.runtime.signals import Stop
from roadtorch.train.processes import Processes, join_processes
from tests.train.conftest import Trained
from tests.train.runs import CONFIGS, rows_of, run, torchrun, write_config

TOLERANCE = 1e-4  # of the weights after a few dozen steps: sums in another order

DESCENT = ("descent.method=sgd", "descent.learning_rate=0.05", "descent.ema=0.7")

MEMBER = """
import os, runpy, sys, torch
from roadtorch.runtime.signals import Stop
from roadtorch.train.processes import join_processes


def gloo_threads():
    tasks = os.listdir("/proc/self/task")
    names = [open(f"/proc/self/task/{task}/comm").read().strip() for task in tasks]
    return [name for name in names if "gloo" in name]


with join_processes(Stop()) as processes:
    weight = torch.nn.Parameter(torch.ones(3))
    optimiser = torch.optim.SGD([weight], 0.1)
    (weight * (processes.rank + 1)).sum().backward()
    added, ranks = processes.add(weight.grad).tolist(), processes.gather(processes.rank)
    if processes.rank == 1:
        processes.stop.ask(15)
    asked = processes.stopped()
    optimiser.step()
file = open(f"member{processes.rank}", "w")
print(added, ranks, asked, processes.share(list("abc")), sep="; ", file=file)
print(gloo_threads(), file=file)
port = int(os.environ["MASTER_PORT"])
os.environ["TORCHELASTIC_USE_AGENT_STORE"] = "False"  # torchrun's own serves one group
for number, words in enumerate(sys.argv[1:], 1):
    os.environ["MASTER_PORT"] = str(port + number)
    sys.argv = ["roadtorch.train", *words.split()]
    try:
        runpy.run_module("roadtorch.train", run_name="__main__")
    except SystemExit as left:
        print(left.code, file=file)
print(gloo_threads(), file=file, flush=True)
"""


def test_alone_there_is_nothing_to_add(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)

    with join_processes(Stop()) as processes:
        assert processes == Processes(0, 1)
        assert processes.leads
        assert processes.gather("a") == ["a"]
        assert list(processes.share("abc")) == ["a", "b", "c"]


def test_what_the_first_one_is_refused_is_raised_in_each() -> None:
    refused = InputError("run", "another run is writing here", "wait for it")

    class Second(Processes):
        def gather(self, item: object) -> list[object]:  # type: ignore[override]
            return [refused, item]

    with pytest.raises(InputError, match="another run"), Second(1, 2).led(nullcontext()):
        raise AssertionError("the block began")


@pytest.fixture(scope="module")
def two(streets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What two processes left that ran ``MEMBER`` and a training of each kind."""
    folder = tmp_path_factory.mktemp("two")
    (folder / "member.py").write_text(MEMBER)
    changes = " ".join(f"--set {change}" for change in DESCENT)
    lines = []
    for kind, text in CONFIGS.items():
        write_config(folder / f"{kind}.toml", text)
        lines.append(f"--config {kind}.toml --images {streets} --out {kind} {changes}")
    done = run([*torchrun(2), "member.py", *lines], folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="threads are read from /proc")
def test_two_add_gather_and_leave_no_thread_behind(two: Path) -> None:
    """Threads of gloo that outlive the group crash one run in thirty as it ends."""
    told = [(two / f"member{rank}").read_text().splitlines() for rank in range(2)]

    assert told == [
        ["[3.0, 3.0, 3.0]; [0, 1]; True; ['a', 'c']", "[]", "0", "0", "[]"],
        ["[3.0, 3.0, 3.0]; [0, 1]; True; ['b']", "[]", "0", "0", "[]"],
    ]


@pytest.mark.parametrize("kind", CONFIGS)
def test_two_processes_give_the_weights_of_one(
    kind: str, two: Path, trained: Trained, tmp_path: Path
) -> None:
    trained(kind, *DESCENT, out="one")

    outs = (tmp_path / "one", two / kind)
    one, both = (load_network(out / "weights.safetensors") for out in outs)
    for name, weight in one.state_dict().items():
        torch.testing.assert_close(both.state_dict()[name], weight, atol=TOLERANCE, rtol=0)
    assert len(list((two / kind / "prepared").glob("*.npz"))) == 5
    assert (two / kind / "pictures.csv").read_text().count("used") == 5
    assert [row["epoch"] for row in rows_of(outs[1])] == [row["epoch"] for row in rows_of(outs[0])]
