"""Imports of the package and its commands, measured in fresh interpreters; its dataclasses."""

import collections.abc
import dataclasses
import doctest
import importlib
import pkgutil
import resource
import subprocess
import sys
import typing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import roadtorch
from roadtorch.detectors import catalogue
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.testing.scenes import render_scene, write_image

HEAVY = ("torch", "cv2", "skimage", "sklearn", "matplotlib", "scipy", "PIL", "pydantic")


def imported_by(code: str) -> set[str]:
    words = [sys.executable, "-c", f"import sys\n{code}\nprint('\\n', *sys.modules)"]
    printed = subprocess.run(words, capture_output=True, text=True, check=True, timeout=600).stdout
    return {name.partition(".")[0] for name in printed.splitlines()[-1].split()}


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
    def processor_seconds() -> float:
        start = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
        subprocess.run([sys.executable, "-m", "roadtorch", "--help"], stdout=subprocess.DEVNULL)
        return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) - start

    # Once of several is enough: a busy machine only ever adds time.
    assert any(processor_seconds() < 0.3 for _ in range(9))


def test_the_public_names_are_ten_and_an_unknown_one_is_an_attribute_error() -> None:
    names = set(roadtorch.__all__) - {"__version__"}

    assert len(names) == 10
    assert dir(roadtorch) == sorted(names)
    assert all(getattr(roadtorch, name).__name__ == name for name in names)
    with pytest.raises(AttributeError, match="'read_imag'"):
        _ = roadtorch.read_imag  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("name", ["Detector", *dir(roadtorch)])
def test_docstrings_are_true(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_image(tmp_path / "street.jpg", render_scene(1, 240, 320))
    monkeypatch.chdir(tmp_path)
    entries = dict(catalogue._catalogue())
    monkeypatch.setattr(catalogue, "_catalogue", lambda: entries)  # one example adds a detector

    member = Detector if name == "Detector" else getattr(roadtorch, name)
    examples = doctest.DocTestFinder().find(member, name, globs={})
    results = [doctest.DocTestRunner(verbose=False).run(example) for example in examples]

    assert sum(result.attempted for result in results) > 1
    assert not any(result.failed for result in results)


def holds_tensors(kind: Any, outer: tuple[Any, ...] = ()) -> bool:
    """Return whether values of a type hold tensors or arrays, themselves or in their fields."""
    if kind in (torch.Tensor, np.ndarray):
        return True
    if typing.get_origin(kind) is collections.abc.Callable or kind in outer:
        return False
    parts = typing.get_args(kind)
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        parts = tuple(typing.get_type_hints(kind).values())
    return any(holds_tensors(part, (*outer, kind)) for part in parts)


def test_dataclasses_with_tensors_compare_by_identity() -> None:
    modules = pkgutil.walk_packages(roadtorch.__path__, "roadtorch.")
    names = [module.name for module in modules if not module.name.endswith("__main__")]
    classes = {value for name in names for value in vars(importlib.import_module(name)).values()
               if isinstance(value, type) and dataclasses.is_dataclass(value)}  # fmt: skip
    with_tensors = {kind for kind in classes if holds_tensors(kind)}

    assert Detection in with_tensors
    assert {kind for kind in with_tensors if kind.__eq__ is not object.__eq__} == set()
    image = torch.rand(3, 32, 32)
    first, second = (load_detector("fusion:untrained").detect(image) for _ in range(2))
    assert first == first != second
    assert first.cues != second.cues
