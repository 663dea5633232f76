"""What gets imported when, looked at in fresh interpreters."""

import subprocess
import sys
import time

import pytest

import roadtorch

HEAVY = ("torch", "cv2", "skimage", "sklearn", "matplotlib", "scipy", "PIL", "pydantic")


def run_python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    return done.stdout


def imported_by(code: str) -> set[str]:
    loaded = run_python(f"import sys\n{code}\nprint('\\n', *sys.modules)").splitlines()[-1].split()
    return {name.partition(".")[0] for name in loaded}


def test_importing_the_package_is_light() -> None:
    assert imported_by("import roadtorch").isdisjoint({*HEAVY, "click"})


def test_the_command_line_and_help_of_every_command_start_without_the_heavy_packages() -> None:
    code = """
from roadtorch.cli import main
from roadtorch.cli.group import COMMANDS
for words in ["--help"], ["--version"], ["infr"], *([name, "--help"] for name in COMMANDS):
    try: main(words)
    except SystemExit: pass
"""

    assert imported_by(code).isdisjoint(HEAVY)


def test_help_answers_in_under_three_tenths_of_a_second() -> None:
    def seconds() -> float:
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "roadtorch", "--help"], stdout=subprocess.DEVNULL)
        return time.perf_counter() - start

    # The best of several: a busy machine only ever adds time.
    assert min(seconds() for _ in range(9)) < 0.3


def test_public_names_are_sorted_and_all_there() -> None:
    assert roadtorch.__all__ == sorted({*roadtorch._HOMES, "__version__"})
    for name, home in roadtorch._HOMES.items():
        assert getattr(roadtorch, name).__module__ == home, name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'read_imag'"):
        _ = roadtorch.read_imag  # pyright: ignore[reportAttributeAccessIssue]
