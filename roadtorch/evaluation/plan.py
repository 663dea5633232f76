"""What a run compares: detectors by name or wildcard, maps made elsewhere, and the floors."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from torch import Tensor

from roadtorch.data import maps
from roadtorch.data.catalogue import list_datasets, open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.detectors.catalogue import detector_entry, is_pattern, list_detectors
from roadtorch.errors import ConfigError
from roadtorch.evaluation import floors
from roadtorch.evaluation.runner import MEAN_THRESHOLD, Plan, every_kth
from roadtorch.settings import build_settings, parse_assignments

FLOORS = ("prior:rows", "prior:triangle")  # in every run; prior:mean joins where it can


class Described(NamedTuple):
    """One detector of a run: its settings but the threshold, and its default threshold."""

    settings: dict[str, Any]
    threshold: float


def make_plan(
    dataset: Dataset,
    names: Sequence[str],
    assignments: Iterable[str] = (),
    mean_from: str | None = None,
    folders: Sequence[str] = (),
    limit: int | None = None,
) -> Plan:
    """Everything that can be refused before the run is refused here, with ConfigError.

    names: detectors, with wildcards. assignments: ``key=value`` for those detectors.
    mean_from: ``NAME:ROOT`` of the set that teaches ``prior:mean``. folders: maps made
    elsewhere, ``NAME=DIR``. limit: at most so many pictures, evenly spread.
    """
    found = dict(maps.parse_maps(text) for text in folders)
    if len(found) < len(folders):
        raise ConfigError("--maps", "gives two folders one name", "write NAME=DIR")
    detectors = _with_floors(expand_names(names), parse_assignments(assignments))
    masks = mean_masks(dataset, mean_from)
    return Plan(every_kth(dataset, limit), detectors, masks, found)


def expand_names(names: Sequence[str]) -> list[str]:
    """Detector names with wildcards expanded, each once, in the order given.

    The hundreds of a grid need its family: ``oneclass:*:HS``, see ``list_detectors``.
    Raises ConfigError for a name or a pattern that fits nothing.
    """
    found: dict[str, None] = {}
    for name in names:
        if name == floors.MEAN:  # the evaluator's own
            continue
        matches = list_detectors(name) if is_pattern(name) else [detector_entry(name).name]
        found.update(dict.fromkeys(matches))
    return list(found)


def _with_floors(chosen: Sequence[str], values: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Settings by detector: those given for the chosen ones, none for floors nobody named."""
    detectors = dict.fromkeys(chosen, values)
    detectors |= {floor: {} for floor in FLOORS if floor not in chosen}
    for name, given in detectors.items():
        build_settings(detector_entry(name).settings, given)  # refuse before the run
    return detectors


def mean_masks(dataset: Dataset, mean_from: str | None) -> dict[str, Tensor]:
    """The mean masks for prior:mean, by drive; empty where there is nothing to learn from."""
    groups = dataset.groups()
    if mean_from is None:
        return floors.means_of_others(floors.road_shares(dataset)) if len(groups) > 1 else {}
    if len(groups) > 1:
        what = f"is not for {dataset.name}, whose drives teach each other"
        raise ConfigError("--mean-from", what, "leave it out")
    mean = floors.mean_of(floors.road_shares(open_named(mean_from)))
    return {group: mean for group in groups or [""]}


def open_named(text: str) -> Dataset:
    """Open ``NAME:ROOT``; names (``camvid32:literal``) and roots may have colons themselves.

    Raises ConfigError for anything else, DatasetError for an incomplete set.
    """
    known = sorted(list_datasets(), key=len, reverse=True)
    name = next((name for name in known if text.startswith(f"{name}:")), None)
    if name is None:
        what = "does not begin with a data set and a colon"
        raise ConfigError(text, what, "write NAME:ROOT, for example camvid:data/camvid")
    return open_dataset(name, Path(text.removeprefix(f"{name}:")))


def described(plan: Plan) -> dict[str, Described]:
    """Every detector of a plan by name, in the order in which it looks."""
    found = {}
    for name, values in plan.detectors.items():
        settings = build_settings(detector_entry(name).settings, values).model_dump(mode="json")
        threshold = settings.pop("threshold")
        found[name] = Described(settings, threshold)
    for name, folder in plan.maps.items():
        found[name] = Described({"folder": str(folder)}, maps.THRESHOLD)
    if plan.mean_masks:
        found[floors.MEAN] = Described({}, MEAN_THRESHOLD)
    return found
