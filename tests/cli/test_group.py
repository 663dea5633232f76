"""The group of commands: help, errors, signals and shell completion."""

import os
import signal
import sys
from types import ModuleType

import click
import pytest
from click.shell_completion import get_completion_class

import roadtorch
from roadtorch.base.errors import InputError
from roadtorch.cli import group, main
from roadtorch.data.catalogue import DATASET_FORMATS
from roadtorch.detectors.catalogue import list_detectors
from tests.command import Call


def test_version_and_help_go_to_stdout(call: Call) -> None:
    version, help_text = call("--version"), call("--help")

    assert (version.exit_code, version.stdout) == (0, f"roadtorch {roadtorch.__version__}\n")
    assert help_text.exit_code == 0
    for name in ("detectors", "evaluate", "infer", "label"):
        assert f"  {name} " in help_text.stdout
    assert "--debug" in help_text.stdout


def install(monkeypatch: pytest.MonkeyPatch, name: str, command: click.Command) -> None:
    """Add a command, in a module of its own."""
    module = ModuleType(f"{name}_command")
    setattr(module, name, command)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(group.COMMANDS, name, (f"{module.__name__}:{name}", "For a test."))


def failing(error: Exception) -> click.Command:
    """Return a command that raises."""

    @click.command()
    def fails() -> None:
        raise error

    return fails


def test_a_fault_is_one_line_or_a_traceback(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "fails", failing(ZeroDivisionError("oh")))

    short, long, also_long = call("fails"), call("fails", "--debug"), call("--debug", "fails")

    line = "roadtorch: error: fails: a bug in roadtorch: ZeroDivisionError: oh (report it with"
    assert short.exit_code == long.exit_code == 1
    assert short.stderr.startswith(line)
    assert short.stderr.count("\n") == 1
    for result in (long, also_long):
        assert result.stderr.startswith("Traceback")
        assert line in result.stderr


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("when", ["before the command", "in the command", "where it is mistaken"])
def test_a_signal_is_reported_as_a_signal(
    number: signal.Signals, status: int, when: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt() -> None:
        os.kill(os.getpid(), number)

    @click.command()
    def reads() -> None:
        try:
            interrupt()
        except KeyboardInterrupt:
            if when == "in the command":
                raise
            raise InputError("progress.safetensors", "is damaged", "remove it") from None

    install(monkeypatch, "reads", reads)
    if when == "before the command":
        monkeypatch.setattr(group, "open_streams", interrupt)

    result = call("reads")

    assert result.exit_code == status
    assert result.stderr.strip() == "roadtorch: interrupted"
    assert set(group.INTERRUPT_MESSAGES) < set(group.COMMANDS)


def test_a_closed_pipe_is_no_crash(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "fails", failing(BrokenPipeError(32, "Broken pipe")))

    result = call("fails")

    assert result.exit_code == 1
    assert result.stderr == ""


# --- completion -------------------------------------------------------------------------


def completions(line: str) -> list[str]:
    """Return the completions of the last word of a line, which may be empty."""
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
        ("evaluate ", sorted(DATASET_FORMATS)),
        *((line, ["file"]) for line in ("infer str", "label str", "evaluate a b --detector ./")),
        *((line, ["file"]) for line in ("train --config none", "train --images str")),
        ("infer --detector nothing-of-that-name", []),
    ],
)
def test_commands_detectors_data_sets_and_files_are_completed(line: str, values: list[str]) -> None:
    assert completions(line) == values


def test_all_detectors_are_offered_and_behind_a_misspelt_command_the_commands() -> None:
    assert completions("infer --detector ") == list_detectors("*")
    assert "infer" in completions("infr --set ")
