"""roadtorch completion: what a shell is told could come next, and what makes it ask.

Each ``suggest_…`` is a ``shell_complete`` of click: what stands before and the word so far, to
items.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    add_completion_class,
    get_completion_class,
    split_arg_string,
)

from roadtorch.errors import RoadtorchError

if TYPE_CHECKING:
    from roadtorch.settings import Settings

VARIABLE = "_ROADTORCH_COMPLETE"
"""Of the environment: the shell asks for what could come next. click's name for it."""

SHELLS = ("bash", "fish", "zsh")


@add_completion_class
class Bash(BashComplete):
    """Bash breaks words at ``:`` and ``=``, where our names and settings have them.

    So it hands over the line as far as the cursor, and gets back what goes behind the break.
    """

    source_template = """\
%(complete_func)s() {
    local IFS=$'\\n' type value response
    response=$(env COMP_LINE="${COMP_LINE:0:$COMP_POINT}" COMP_WORDBREAKS="$COMP_WORDBREAKS" \\
        %(complete_var)s=bash_complete "$1")
    COMPREPLY=()
    for completion in $response; do
        IFS=',' read -r type value <<< "$completion"
        case $type in
            dir) compopt -o dirnames ;;
            file) compopt -o default ;;
            plain)
                COMPREPLY+=("$value")
                [[ $value == *[=:] ]] && compopt -o nospace ;;
        esac
    done
    return 0
}
complete -o nosort -F %(complete_func)s %(prog_name)s
"""

    def get_completion_args(self) -> tuple[list[str], str]:
        """The words before the one at the cursor, and that one as far as it is there."""
        line = os.environ["COMP_LINE"]
        words = split_arg_string(line)[1:]
        if not words or line[-1:].isspace():
            return words, ""
        return words[:-1], words[-1]

    def format_completion(self, item: CompletionItem) -> str:
        """Type and value, less what stands before the last break of the word."""
        breaks = set(os.environ.get("COMP_WORDBREAKS", "")) & set(":=")
        word = self.get_completion_args()[1]
        kept = max((word.rfind(letter) for letter in breaks), default=-1) + 1
        value = item.value if item.type != "plain" else item.value[kept:]
        return f"{item.type},{value}"


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print what makes SHELL complete commands, options, detectors, settings and data sets.

    \b
    bash  echo 'eval "$(roadtorch completion bash)"' >> ~/.bashrc
    zsh   echo 'eval "$(roadtorch completion zsh)"' >> ~/.zshrc
    fish  roadtorch completion fish > ~/.config/fish/completions/roadtorch.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "roadtorch", VARIABLE).source())


# --- what can come next ----------------------------------------------------------------


Suggest = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def suggest_files(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Files and folders: the shell knows them."""
    return [CompletionItem(incomplete, type="file")]


def _of_names(known: Callable[[str], Mapping[str, str]], or_files: bool = False) -> Suggest:
    """What suggests names, with their meanings where there are some, or else a file.

    known: gives those that may go on from what is there.
    """

    def suggest(
        context: click.Context, parameter: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        names = known(incomplete).items()
        found = [
            CompletionItem(name, help=meaning or None)
            for name, meaning in names
            if name.startswith(incomplete)
        ]
        return found or (suggest_files(context, parameter, incomplete) if or_files else [])

    return suggest


def _detectors(incomplete: str) -> Mapping[str, str]:
    """Detectors; those of a grid of hundreds once the grid's family is there."""
    from roadtorch.detectors.catalogue import detector_groups

    found: dict[str, str] = {}
    for name, entries in detector_groups().items():
        grid = entries[0].grid
        if grid is None:
            found[name] = entries[0].summary
        elif incomplete.startswith(grid.family):
            found |= {entry.name: entry.summary for entry in entries}
        else:
            found[grid.family] = grid.summary
    return found


def _datasets(ending: str) -> Mapping[str, str]:
    """Labelled sets, for ``NAME:ROOT`` with a colon."""
    from roadtorch.data.catalogue import list_datasets

    return dict.fromkeys((name + ending for name in list_datasets()), "")


def _splits(_: str) -> Mapping[str, str]:
    """Splits of any set: click does not tell which one was named while a value is missing."""
    from roadtorch.data.catalogue import dataset_kind, list_datasets

    known = {split for name in list_datasets() for split in dataset_kind(name).splits}
    return dict.fromkeys(sorted(known), "")


def _configs(of_detectors: bool) -> Mapping[str, str]:
    """Shipped configs: of detectors, or of ``roadtorch train``."""
    from roadtorch.runtime.shipped_configs import THRESHOLDS, shipped_configs

    names = [one for one in shipped_configs() if one.startswith(THRESHOLDS) == of_detectors]
    return dict.fromkeys(names, "")


suggest_detectors = _of_names(_detectors)
suggest_candidates = _of_names(_detectors, or_files=True)
suggest_datasets = _of_names(lambda _: _datasets(""))
suggest_rooted_datasets = _of_names(lambda _: _datasets(":"))
suggest_splits = _of_names(_splits)
suggest_training_configs = _of_names(lambda _: _configs(False), or_files=True)
suggest_detector_configs = _of_names(lambda _: _configs(True), or_files=True)


def suggest_settings(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """``KEY=`` of the detector, the labeller or the training at hand, then the key's values."""
    key, assigned, _value = incomplete.partition("=")
    rows: list[tuple[str, ...]] = []
    with suppress(RoadtorchError):  # of a detector or a config that is not there
        rows += setting_rows(_settings_at_hand(context).model_json_schema())
    known = {f"{row[0]}=": row[-1] for row in rows}
    if assigned:
        named = (row for row in rows if row[0] == key)
        values = (f"{key}={value}" for row in named for value in _values(*row[:4]))
        known = dict.fromkeys(values, "")
    return _of_names(lambda _: known)(context, parameter, incomplete)


def _settings_at_hand(context: click.Context) -> "type[Settings]":
    """The settings that ``--set`` of this command means, as far as the command is there."""
    from roadtorch.detectors.catalogue import detector_entry, is_pattern, list_detectors
    from roadtorch.layout.labeller import LabellerSettings
    from roadtorch.runs.options import DEFAULT_DETECTOR
    from roadtorch.settings import read_settings_file
    from roadtorch.train.config import KINDS, PatchTraining

    config = context.params.get("config")
    values: Mapping[str, Any] = read_settings_file(config) if isinstance(config, Path) else {}
    if context.info_name == "train":
        return KINDS.get(str(values.get("kind")), PatchTraining)
    if context.info_name == "label":
        return LabellerSettings
    several = context.params.get("names") or ()  # of evaluate and tune
    given = (*several, context.params.get("detector"), values.get("detector"))
    name = next(filter(None, given), DEFAULT_DETECTOR)
    return detector_entry(list_detectors(name)[0] if is_pattern(name) else name).settings


def _values(key: str, kind: str, default: str, allowed: str) -> Iterable[str]:
    """What a setting may be, where that is a list, or its default."""
    if key == "start":
        from roadtorch.layout.weights import list_shipped_weights

        return list_shipped_weights()
    if kind == "boolean":
        return ("true", "false")
    return allowed.split(" | ") if kind == "choice" else filter(None, [default])


# --- what can be set --------------------------------------------------------------------


def setting_rows(
    schema: Mapping[str, Any],
    shared: Mapping[str, Any] | None = None,
    defaults: Mapping[str, Any] | None = None,
    path: str = "",
) -> Iterator[tuple[str, str, str, str, str]]:
    """Key, type, default, allowed and meaning of each setting in a JSON schema, depth first.

    shared: definitions that the schema refers to. defaults: those that the owner of a group of
    settings gives it, which go before the group's own. path: what stands before its keys.
    """
    definitions = schema.get("$defs", {}) if shared is None else shared
    defaults = defaults or {}
    for key, field in schema.get("properties", {}).items():
        meaning = field.get("description", "")
        target = definitions.get(str(field.get("$ref", "")).rpartition("/")[2], field)
        given = defaults.get(key, field.get("default"))
        if "properties" in target:
            yield from setting_rows(target, definitions, given, f"{path}{key}.")
        else:
            default = _text(given) if "default" in field or key in defaults else ""
            yield f"{path}{key}", _kind(target), default, _allowed(target), meaning


def _kind(field: Mapping[str, Any]) -> str:
    if "anyOf" in field:
        return " or ".join(_kind(option) for option in field["anyOf"])
    values = field.get("enum", [field["const"]] if "const" in field else None)
    return "choice" if values else str(field.get("type", "any"))


def _allowed(field: Mapping[str, Any]) -> str:
    if "anyOf" in field:
        return ", ".join(filter(None, (_allowed(option) for option in field["anyOf"])))
    if "enum" in field or "const" in field:
        return " | ".join(map(_text, field.get("enum", [field.get("const")])))
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    return ", ".join(f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field)


def _text(value: Any) -> str:
    """A value as ``--set`` takes it; strings without their quotes, 30.0 as 30."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
