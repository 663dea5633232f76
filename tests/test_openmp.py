"""How torch's threads wait: asleep where this package loads it, else as somebody has settled it."""

import os
import subprocess
import sys

import pytest

TOLD = "import os, sys; print('torch' in sys.modules, os.environ.get('OMP_WAIT_POLICY'))"
SEEN = """
from importlib.abc import MetaPathFinder
import os, sys
class Watch(MetaPathFinder):
    def find_spec(self, name, *_):
        if name == "torch":
            print("torch is loaded", os.environ.get("OMP_WAIT_POLICY"))
sys.meta_path.insert(0, Watch())
"""


def told(code: str, **variables: str) -> str:
    rest = {k: v for k, v in os.environ.items() if k not in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")}
    done = subprocess.run(
        [sys.executable, "-c", f"{SEEN}\n{code}\n{TOLD}"],
        capture_output=True, text=True, check=True, env=rest | variables,
    )  # fmt: skip
    return done.stdout


def test_a_torch_that_the_package_loads_has_threads_that_sleep_and_nothing_stays_behind() -> None:
    assert told("from roadtorch import load_detector") == "torch is loaded passive\nTrue None\n"


def test_who_loads_torch_first_keeps_what_he_has() -> None:
    code = "import torch; from roadtorch import load_detector"

    assert told(code) == "torch is loaded None\nTrue None\n"


@pytest.mark.parametrize(
    ("variables", "policy"),
    [({"OMP_WAIT_POLICY": "active"}, "active"), ({"GOMP_SPINCOUNT": "1000"}, "None")],
)
def test_what_the_environment_says_stays(variables: dict[str, str], policy: str) -> None:
    out = told("from roadtorch import load_detector", **variables)

    assert out == f"torch is loaded {policy}\nTrue {policy}\n"
