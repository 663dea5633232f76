"""The check for changes that must not change anything: it records no failure."""

import subprocess
from contextlib import nullcontext
from pathlib import Path

import click
import pytest

from roadtorch.cli import main
from scripts import freeze


@pytest.mark.parametrize("output", sorted(freeze.OUTPUTS))
def test_the_commands_that_it_records_are_right(output: str) -> None:
    name, *words = freeze.OUTPUTS[output].format(all="--detector cpf").split()
    command = main.get_command(click.Context(main), name)
    if command is None or "--help" in words or output == "commands/nothing":
        return
    out = [] if output.startswith("commands/") else ["--out", "out"]

    command.make_context(name, [*words, *out])


@pytest.mark.parametrize(
    ("output", "status", "is_kept"),
    [("a/b", 0, True), ("commands/no-key", 2, True), ("a/b", 1, False)],
)
def test_a_failed_command_is_not_recorded(
    output: str, status: int, is_kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = subprocess.CompletedProcess([], status, "", "")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    monkeypatch.setattr(freeze, "OUTPUTS", {output: "infer"})

    with nullcontext() if is_kept else pytest.raises(SystemExit, match="a/b: exit 1"):
        assert list(freeze.outputs(output.split("/")[0], tmp_path, tmp_path))
