"""The check for changes that must not change anything: its commands are right ones."""

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

    assert command.make_context(name, [*words, *out]).info_name == name
