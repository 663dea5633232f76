"""How the threads of torch wait: briefly where this package loads it, else as somebody said."""

import os
import subprocess
import sys

import pytest

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
