"""What can come next on the command line: names of detectors, settings, configs, data sets.

Each function is a ``shell_complete`` of click: what stands before and the word so far, to items.
"""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from roadtorch.cli.setting_rows import describe
from roadtorch.errors import RoadtorchError

if TYPE_CHECKING:
    from roadtorch.settings import Settings


def suggest_files(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Files and folders: the shell knows them."""
    return [CompletionItem(incomplete, type="file")]


def suggest_detectors(
    _: click.Context, __: click.Parameter, incomplete: str
) -> list[CompletionItem]:
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
    return _beginning(found, incomplete)


def suggest_candidates(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """What can be compared by name, or else a file."""
    return suggest_detectors(context, parameter, incomplete) or suggest_files(
        context, parameter, incomplete
    )


def suggest_datasets(
    _: click.Context, __: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Labelled sets."""
    from roadtorch.data.catalogue import list_datasets

    return _beginning(dict.fromkeys(list_datasets(), ""), incomplete)


def suggest_rooted_datasets(
    _: click.Context, __: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Labelled sets for ``NAME:ROOT``."""
    from roadtorch.data.catalogue import list_datasets

    return _beginning(dict.fromkeys((f"{name}:" for name in list_datasets()), ""), incomplete)


def suggest_splits(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Splits of any set: click does not tell which one was named while a value is missing."""
    from roadtorch.data.catalogue import dataset_kind, list_datasets

    known = {split for name in list_datasets() for split in dataset_kind(name).splits}
    return _beginning(dict.fromkeys(sorted(known), ""), incomplete)


def suggest_training_configs(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Shipped configs of ``roadtorch train``, or else a file."""
    from roadtorch.runtime.shipped_configs import THRESHOLDS, shipped_configs

    names = [name for name in shipped_configs() if not name.startswith(THRESHOLDS)]
    found = _beginning(dict.fromkeys(names, ""), incomplete)
    return found or suggest_files(context, parameter, incomplete)


def suggest_detector_configs(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Shipped configs of detectors, or else a file."""
    from roadtorch.runtime.shipped_configs import THRESHOLDS, shipped_configs

    names = [name for name in shipped_configs() if name.startswith(THRESHOLDS)]
    found = _beginning(dict.fromkeys(names, ""), incomplete)
    return found or suggest_files(context, parameter, incomplete)


def suggest_settings(
    context: click.Context, _: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """``KEY=`` of the detector, the labeller or the training at hand, then the key's values."""
    key, assigned, _value = incomplete.partition("=")
    rows: list[tuple[str, ...]] = []
    with suppress(RoadtorchError):  # of a detector or a config that is not there
        rows += describe(_settings_at_hand(context).model_json_schema())
    if not assigned:
        return _beginning({f"{row[0]}=": row[-1] for row in rows}, incomplete)
    named = (row for row in rows if row[0] == key)
    values = (f"{key}={value}" for row in named for value in _values(*row[:4]))
    return _beginning(dict.fromkeys(values, ""), incomplete)


def _settings_at_hand(context: click.Context) -> "type[Settings]":
    """The settings that ``--set`` of this command means, as far as the command is there."""
    from roadtorch.cli.config import DEFAULT_DETECTOR
    from roadtorch.detectors.catalogue import detector_entry, is_pattern, list_detectors
    from roadtorch.layout.labeller import LabellerSettings
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


def _beginning(found: Mapping[str, str], incomplete: str) -> list[CompletionItem]:
    """Items for the names that go on from what is there; with their meanings, where there are."""
    return [
        CompletionItem(name, help=meaning or None)
        for name, meaning in found.items()
        if name.startswith(incomplete)
    ]
