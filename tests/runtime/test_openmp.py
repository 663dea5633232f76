"""How the threads of torch wait, briefly where this package loads it, else as somebody said; and
how many of them there are."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch

from roadtorch import load_detector
from roadtorch.detectors import fusion
from roadtorch.runtime import openmp
from roadtorch.runtime.openmp import at_most, free_cores
from tests.streets import scene

SAYS = "os.environ.get('OMP_WAIT_POLICY'), os.environ.get('GOMP_SPINCOUNT')"
TOLD = f"import os, sys; print('torch' in sys.modules, {SAYS})"
SEEN = f"""
from importlib.abc import MetaPathFinder
import os, sys
class Watch(MetaPathFinder):
    def find_spec(self, name, *_):
        if name == "torch":
            print("torch is loaded", {SAYS})
sys.meta_path.insert(0, Watch())
"""


def told(code: str, **variables: str) -> str:
    rest = {k: v for k, v in os.environ.items() if k not in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")}
    done = subprocess.run(
        [sys.executable, "-c", f"{SEEN}\n{code}\n{TOLD}"],
        capture_output=True, text=True, check=True, env=rest | variables,
    )  # fmt: skip
    return done.stdout


def test_a_torch_that_the_package_loads_has_threads_that_wait_briefly_and_nothing_stays() -> None:
    said = "torch is loaded passive 20000\nTrue None None\n"

    assert told("from roadtorch import load_detector") == said


def test_who_loads_torch_first_keeps_what_he_has() -> None:
    code = "import torch; from roadtorch import load_detector"

    assert told(code) == "torch is loaded None None\nTrue None None\n"


@pytest.mark.parametrize(
    ("variables", "said"),
    [({"OMP_WAIT_POLICY": "active"}, "active None"), ({"GOMP_SPINCOUNT": "1000"}, "None 1000")],
)
def test_what_the_environment_says_stays(variables: dict[str, str], said: str) -> None:
    out = told("from roadtorch import load_detector", **variables)

    assert out == f"torch is loaded {said}\nTrue {said}\n"


# --- how many -----------------------------------------------------------------------------


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def processors_used(call: Callable[[], object]) -> float:
    """Processor time over time, while a call is made again and again for a tenth of a second."""
    call()
    start, spent = time.perf_counter(), time.process_time()
    while time.perf_counter() - start < 0.1:
        call()
    return (time.process_time() - spent) / (time.perf_counter() - start)


@pytest.mark.parametrize(
    "call",
    [
        lambda maps: torch.mm(maps, maps),
        lambda maps: maps.exp(),
        lambda maps: torch.conv2d(maps[None, None], maps[None, None, :9, :9]),
    ],
    ids=["product", "each value", "convolution"],
)
def test_at_most_one_thread_computes_alone_and_afterwards_all_do(
    call: Callable[[torch.Tensor], torch.Tensor], two_threads: None
) -> None:
    maps = torch.rand(900, 900)

    with at_most(1):
        inside = torch.get_num_threads(), processors_used(lambda: call(maps))

    assert inside[0] == 1
    assert inside[1] < 1.1
    assert torch.get_num_threads() == 2


def test_other_threads_keep_what_they_have_and_new_ones_get_it(two_threads: None) -> None:
    with at_most(1), ThreadPoolExecutor(1) as pool:
        assert pool.submit(torch.get_num_threads).result() == 2


def test_no_more_threads_are_made_than_the_program_wants(two_threads: None) -> None:
    with at_most(7):
        assert torch.get_num_threads() == 2


def test_an_error_inside_gives_the_threads_back(two_threads: None) -> None:
    with pytest.raises(ValueError, match="inside"), at_most(1), at_most(1):
        raise ValueError("inside")

    assert torch.get_num_threads() == 2


def test_without_a_runtime_that_can_be_reached_nothing_changes(
    two_threads: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(openmp, "_runtime", lambda: None)

    with at_most(1):
        assert torch.get_num_threads() == 2


@pytest.mark.parametrize(
    ("running", "own", "free"),
    [
        (1, "R", 4),  # this thread alone
        (3, "RSRS", 3),  # one of another process, and one of ours that spins
        (4, "RRRR", 4),  # all ours
        (9, "RS", 1),  # more than there are cores
    ],
)
def test_cores_are_free_that_no_other_process_holds(
    running: int, own: str, free: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "loadavg").write_text(f"0.52 0.58 0.59 {running}/597 4242\n")
    for number, state in enumerate(own):
        (tmp_path / "task" / str(number)).mkdir(parents=True)
        (tmp_path / "task" / str(number) / "stat").write_text(f"7 (a) R) {state} 1 2 3\n")
    (tmp_path / "task" / "ended").mkdir()
    monkeypatch.setattr(openmp, "LOAD", tmp_path / "loadavg")
    monkeypatch.setattr(openmp, "OWN_THREADS", tmp_path / "task")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(4)), raising=False)

    assert free_cores() == free


@pytest.mark.parametrize("said", [None, "", "0.1 0.2", "0.1 0.2 0.3 many/9 1"])
def test_where_nobody_tells_all_cores_are_free(
    said: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if said is not None:
        (tmp_path / "loadavg").write_text(said)
    monkeypatch.setattr(openmp, "LOAD", tmp_path / "loadavg")

    assert free_cores() == os.cpu_count()


@pytest.mark.parametrize("free", [1, 2])
def test_detect_takes_no_more_threads_than_there_are_free_cores(
    free: int, two_threads: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    detector, image = load_detector("fusion"), scene(1).image
    look, seen = fusion.look_at, []

    def watched(*args: Any) -> Any:
        seen.append(torch.get_num_threads())
        return look(*args)

    monkeypatch.setattr(fusion, "look_at", watched)
    monkeypatch.setattr(openmp, "free_cores", lambda: free)
    detector.detect(image)
    detector.find(image)
    detector(image[None])

    assert seen == [free] * 3
    assert torch.get_num_threads() == 2
