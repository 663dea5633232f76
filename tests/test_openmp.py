"""How the threads of torch wait, briefly where this package loads it, else as somebody said; and
when one computes alone."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from roadtorch import load_detector, openmp
from roadtorch.detectors import fusion
from roadtorch.openmp import alone_if_small, one_thread
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
    said = "torch is loaded passive 2000\nTrue None None\n"

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


# --- one thread ---------------------------------------------------------------------------


def processors_used(call: Callable[[], object]) -> float:
    """Processor time over time, while a call is made again and again for a tenth of a second."""
    call()
    start, spent = time.perf_counter(), time.process_time()
    while time.perf_counter() - start < 0.1:
        call()
    return (time.process_time() - spent) / (time.perf_counter() - start)


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize(
    "call",
    [
        lambda maps: torch.mm(maps, maps),
        lambda maps: maps.exp(),
        lambda maps: torch.conv2d(maps[None, None], maps[None, None, :9, :9]),
    ],
    ids=["product", "each value", "convolution"],
)
def test_one_thread_computes_alone_and_afterwards_all_do(
    call: Callable[[torch.Tensor], torch.Tensor], two_threads: None
) -> None:
    maps = torch.rand(900, 900)

    with one_thread():
        inside = torch.get_num_threads(), processors_used(lambda: call(maps))

    assert inside[0] == 1
    assert inside[1] < 1.1
    assert torch.get_num_threads() == 2


def test_other_threads_keep_what_they_have_and_new_ones_get_it(two_threads: None) -> None:
    with one_thread(), ThreadPoolExecutor(1) as pool:
        assert pool.submit(torch.get_num_threads).result() == 2


def test_an_error_inside_gives_the_threads_back(two_threads: None) -> None:
    with pytest.raises(ValueError, match="inside"), one_thread(), one_thread():
        raise ValueError("inside")

    assert torch.get_num_threads() == 2


@pytest.mark.parametrize(("size", "threads"), [((16, 16), 1), ((724, 724), 1), ((1024, 512), 2)])
def test_small_images_are_worked_on_by_one_thread(
    size: tuple[int, int], threads: int, two_threads: None
) -> None:
    seen = alone_if_small(lambda image, factor: torch.get_num_threads() * factor)

    assert seen(torch.zeros(3, *size), factor=10) == 10 * threads
    assert seen(factor=10, image=torch.zeros(3, *size)) == 10 * threads


def test_without_a_runtime_that_can_be_reached_nothing_changes(
    two_threads: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(openmp, "_runtime", lambda: None)

    with one_thread():
        assert torch.get_num_threads() == 2


def test_detectors_on_small_maps_compute_alone(
    two_threads: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    detector, image = load_detector("fusion"), scene(1).image
    look, seen = fusion.look_at, []

    def watched(*args: object) -> object:
        seen.append(torch.get_num_threads())
        return look(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(fusion, "look_at", watched)
    detector.detect(image)

    assert seen == [1]
