"""The size of the project: lines by folder, names at the top, dependencies, options, commands.

Each number here is a limit, so that removed code does not grow back. Raise one only in the commit
that needs it, and state the reason in that commit's message; lower it when a folder shrinks.
"""

import subprocess
import tomllib
from pathlib import Path

import click
import pytest

from roadtorch.cli.group import COMMANDS, main

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {".py", ".sh", ".c", ".js", ".css", ".html"}
LINES = {
    "roadtorch/annotate": 2_147,
    "roadtorch/base": 2_152,
    "roadtorch/camera": 2_128,
    "roadtorch/cli": 1_962,
    "roadtorch/data": 2_459,
    "roadtorch/detectors": 2_239,
    "roadtorch/evaluation": 3_551,
    "roadtorch/export": 889,
    "roadtorch/imaging": 1_062,
    "roadtorch/inputs": 1_509,
    "roadtorch/layout": 1_471,
    "roadtorch/oneclass": 1_729,
    "roadtorch/road": 1_497,
    "roadtorch/ros": 534,
    "roadtorch/run": 2_197,
    "roadtorch/testing": 636,
    "roadtorch/train": 3_935,
    "roadtorch/ufl": 1_345,
    "scripts": 4_503,
    "tests": 26_457,
    "train": 4_435,
}
"""The lines of source code that each folder may have."""

REPOSITORY_BYTES = 20 * 2**20
"""The bytes of all files, without the history."""

TOP_NAMES = 18
DEPENDENCIES = 14
OPTIONS = 82
COMMAND_COUNT = 11

REASON = "cut something, or raise the number and state the reason in the same commit"


@pytest.mark.parametrize(("folder", "limit"), LINES.items())
def test_a_folder_is_no_larger_than_it_may_be(folder: str, limit: int) -> None:
    files = [path for path in (ROOT / folder).rglob("*") if path.suffix in SOURCES]
    lines = sum(path.read_bytes().count(b"\n") for path in files)

    assert lines <= limit, f"{folder} has {lines} lines, {limit} are allowed: {REASON}"


def test_the_repository_stays_small_enough_to_clone() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    files = [ROOT / name for name in listed.stdout.split("\0") if name]
    if not files:
        pytest.skip("this is no git checkout")

    assert sum(file.stat().st_size for file in files if file.is_file()) <= REPOSITORY_BYTES, REASON


def test_every_package_has_a_limit_and_the_top_stays_small() -> None:
    packages = {f"roadtorch/{path.parent.name}" for path in ROOT.glob("roadtorch/*/__init__.py")}

    assert packages == {folder for folder in LINES if folder.startswith("roadtorch/")}
    assert len(packages) <= TOP_NAMES, REASON


def test_mandatory_dependencies_stay_few() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

    assert len(project["dependencies"]) <= DEPENDENCIES, REASON


def test_commands_and_their_options_stay_few() -> None:
    context = click.Context(main)
    commands = [main.get_command(context, name) for name in COMMANDS]
    options = [
        parameter.name
        for command in commands
        if command is not None
        for parameter in command.params
        if isinstance(parameter, click.Option)
    ]

    assert len(commands) <= COMMAND_COUNT, REASON
    assert len(options) <= OPTIONS, REASON
