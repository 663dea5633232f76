"""What shells are told could come next: asked as bash, zsh and fish ask."""

import subprocess
import sys

import pytest
from click.shell_completion import get_completion_class

from roadtorch.cli import main
from roadtorch.cli.completion import SHELLS, VARIABLE
from roadtorch.data.catalogue import list_datasets
from roadtorch.layout.weights import list_shipped_weights
from roadtorch.runtime.shipped_configs import shipped_configs
from tests.command import Call


def offered(line: str, shell: str = "zsh") -> list[str]:
    """The values offered for the last word of a line, which may be empty."""
    kind = get_completion_class(shell)
    assert kind is not None
    *words, incomplete = line.split(" ")
    items = kind(main, {}, "roadtorch", VARIABLE).get_completions(words, incomplete)
    return [item.value if item.type == "plain" else item.type for item in items]


@pytest.mark.parametrize(
    ("line", "values"),
    [
        ("doc", ["doctor"]),
        ("infer --detector cpf", ["cpf", "cpf:squares", "cpf:v2"]),
        ("infer --detector one", ["oneclass:"]),
        ("detectors cpf:", ["cpf:squares", "cpf:v2"]),
        ("infer --detector cpf --set isolated=", ["isolated=drop", "isolated=keep"]),
        ("infer --detector cpf --set texture.bins=", ["texture.bins=64"]),
        ("infer --set learned.d", ["learned.detail="]),
        ("evaluate camvid . --detector cpf* --set threshold", ["threshold="]),
        ("label --set supp", ["support="]),
        ("train --config adapt --set teacher.mar", ["teacher.margin="]),
        ("train --config cnn7 --set centres.", ["centres.around=", "centres.distance="]),
        (
            "train --config adapt --set start=",
            [f"start={name}" for name in list_shipped_weights()],
        ),
        ("train --config ad", ["adapt"]),
        (
            "infer --config thresholds/cpf",
            [f"thresholds/cpf{end}" for end in ("", "-squares", "-v2")],
        ),
        ("evaluate idd", ["idd-lite"]),
        ("tune camvid32:", ["camvid32:literal", "camvid32:literal-ignore"]),
        ("evaluate camvid . --split tr", ["train"]),
        ("compare cpf fusion --labelled idd", ["idd-lite:"]),
        ("completion ", list(SHELLS)),
    ],
)
def test_names_are_completed(line: str, values: list[str]) -> None:
    assert offered(line)[: len(values) + 1] == values


def test_what_is_offered_is_everything() -> None:
    assert offered("evaluate ") == list_datasets()
    named = offered("train --config ") + offered("infer --config ")
    assert sorted(named) == shipped_configs()
    assert len(offered("infer --detector oneclass:")) == 310 + 95


@pytest.mark.parametrize(
    "line", ["infer str", "label str", "compare nothing-of-that-name", "train --images str"]
)
def test_files_are_left_to_the_shell(line: str) -> None:
    assert offered(line) == ["file"]


@pytest.mark.parametrize(
    "line",
    [
        "infer --detector nothing --set ",
        "infer --config none.toml --set ",
        "train --config nothing --set nothing",
        "evaluate camvid . --split nothing",
    ],
)
def test_what_is_wrong_before_offers_nothing_and_raises_nothing(line: str) -> None:
    assert offered(line) == []


def test_behind_a_misspelt_command_the_commands_are_offered() -> None:
    assert "infer" in offered("infr --set ")


@pytest.mark.parametrize("shell", SHELLS)
def test_each_shell_gets_its_script(call: Call, shell: str) -> None:
    result = call("completion", shell)

    assert result.exit_code == 0
    assert f"{VARIABLE}={shell}_complete" in result.stdout


IN_BASH = {
    "roadtorch infer --detector cpf:": "squares v2",
    "roadtorch train --config adapt --set star": "start=",
}


def test_bash_gets_what_stands_behind_its_word_break() -> None:
    """What a real bash would write in the place of the last part of a line's last word."""
    asked = "\n".join(
        f"""
        COMP_LINE='{line}'; COMP_POINT=${{#COMP_LINE}}; COMPREPLY=()
        _roadtorch_completion roadtorch; echo "${{COMPREPLY[@]}}"
        """
        for line in IN_BASH
    )
    code = f"""
    roadtorch() {{ "{sys.executable}" -m roadtorch "$@"; }}
    compopt() {{ :; }}
    eval "$(roadtorch completion bash)"
    env() {{ (while [[ $1 == *=* ]]; do export "$1"; shift; done; "$@"); }}
    COMP_WORDBREAKS=$' \\t\\n"\\'><=;|&(:'
    {asked}
    """
    done = subprocess.run(
        ["bash", "--norc", "-c", code], capture_output=True, text=True, check=True, timeout=120
    )

    assert done.stdout.splitlines() == list(IN_BASH.values())
