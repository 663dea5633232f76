"""What shells are told could come next, asked as click's own completion asks."""

import pytest
from click.shell_completion import get_completion_class

from roadtorch.cli import main
from roadtorch.data.catalogue import list_datasets
from roadtorch.detectors.catalogue import list_detectors


def offered(line: str) -> list[str]:
    """The values offered for the last word of a line, which may be empty."""
    kind = get_completion_class("zsh")
    assert kind is not None
    *words, incomplete = line.split(" ")
    items = kind(main, {}, "roadtorch", "_ROADTORCH_COMPLETE").get_completions(words, incomplete)
    return [item.value if item.type == "plain" else item.type for item in items]


@pytest.mark.parametrize(
    ("line", "values"),
    [
        ("doc", ["doctor"]),
        ("infer --detector cpf", ["cpf", "cpf:squares", "cpf:v2"]),
        ("detectors cpf:", ["cpf:squares", "cpf:v2"]),
        ("evaluate ", list_datasets()),
        ("infer --detector ", list_detectors("*")),
        *((line, ["file"]) for line in ("infer str", "label str", "evaluate a b --detector ./")),
        *((line, ["file"]) for line in ("train --config none", "train --images str")),
        ("infer --detector nothing-of-that-name", []),
    ],
)
def test_commands_detectors_data_sets_and_files_are_completed(line: str, values: list[str]) -> None:
    assert offered(line) == values


def test_behind_a_misspelt_command_the_commands_are_offered() -> None:
    assert "infer" in offered("infr --set ")
