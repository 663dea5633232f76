"""Who is scored: detectors by name or wildcard, maps made elsewhere, and the floors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import torch
from torch import Tensor

from roadtorch.data import maps
from roadtorch.data.dataset import Dataset, Item
from roadtorch.detector import Detection, DetectorSettings
from roadtorch.detectors.catalogue import (
    detector_entry,
    is_pattern,
    list_detectors,
    load_detector,
)
from roadtorch.errors import ConfigError
from roadtorch.evaluation.mean_mask import mean_of, means_of_others, resize, road_shares
from roadtorch.settings import build_settings

FLOORS = ("prior:rows", "prior:triangle")  # in every run; prior:mean joins where it can

MEAN = "prior:mean"  # the evaluator's own

MEAN_THRESHOLD = 0.5  # road at this place in at least half of the pictures

Look = Callable[[Tensor, Item], Detection]


@dataclass(frozen=True)
class Contender:
    """One detector of a run.

    prepare: makes it ready to look at a set's pictures; it travels to processes. settings:
    all of them but the threshold, as JSON can hold them. threshold: its default one.
    """

    name: str
    prepare: Callable[[Dataset], Look] = field(repr=False)
    settings: Mapping[str, Any] = field(default_factory=dict)
    threshold: float = 0.5
    is_floor: bool = False


def contenders_for(
    dataset: Dataset,
    detectors: Sequence[str],
    settings: Mapping[str, Any],
    folders: Mapping[str, Path],
    mean_from: Dataset | None,
) -> list[Contender]:
    """The detectors, those that give maps from folders, and the floors, in this order.

    detectors: names, with wildcards. settings: values for all that are named. folders: by
    name, maps made elsewhere. mean_from: the set that teaches ``prior:mean``.
    Raises ConfigError for whatever can be refused before the run.
    """
    chosen = expand_names(detectors)
    found = [named_detector(name, settings) for name in chosen]
    found += [named_detector(name, {}) for name in FLOORS if name not in chosen]
    found += [maps_from(name, folder) for name, folder in folders.items()]
    masks = mean_masks(dataset, mean_from)
    return [*found, mean_floor(masks)] if masks else found


def expand_names(names: Sequence[str]) -> list[str]:
    """Detector names with wildcards expanded, each once, in the order given.

    The hundreds of a grid need its family: ``oneclass:*:HS``, see ``list_detectors``.
    Raises ConfigError for a name or a pattern that fits nothing.
    """
    found: dict[str, None] = {}
    for name in names:
        if name == MEAN:
            continue
        matches = list_detectors(name) if is_pattern(name) else [detector_entry(name).name]
        found.update(dict.fromkeys(matches))
    return list(found)


# --- detectors --------------------------------------------------------------------------


def named_detector(name: str, values: Mapping[str, Any]) -> Contender:
    """A detector of the catalogue; ConfigError for settings that it does not have."""
    entry = detector_entry(name)
    settings = build_settings(entry.settings, values).model_dump(mode="json")
    threshold = settings.pop("threshold")
    return Contender(name, partial(_load, name, values), settings, threshold, entry.floor)


def _load(name: str, values: Mapping[str, Any], _: Dataset) -> Look:
    detector = load_detector(name, **values)
    return lambda image, item: detector.detect(image)


# --- maps -------------------------------------------------------------------------------


def maps_from(name: str, folder: Path) -> Contender:
    """Likelihood maps in a folder, as ``maps:NAME``, judged as config.toml beside them says.

    Raises ConfigError or InputError for a config.toml that cannot be used.
    """
    deciding = maps.deciding_settings(folder)
    settings: dict[str, Any] = {"folder": str(folder)}
    if maps.is_of_infer(folder):
        settings["isolated"] = deciding.isolated
    prepare = partial(_read_maps, folder, deciding)
    return Contender(f"maps:{name}", prepare, settings, deciding.threshold)


def _read_maps(folder: Path, deciding: DetectorSettings, dataset: Dataset) -> Look:
    def look(image: Tensor, item: Item) -> Detection:
        own = (image.shape[-2], image.shape[-1])
        # What infer makes is named like the picture, what KITTI's server takes like the label.
        like_picture = str(PurePath(item.name).with_name(item.image.stem))
        names = list(dict.fromkeys([item.name, like_picture, item.label.stem]))
        likelihood = maps.map_likelihood(folder, names, [own, *_view_size(dataset, item, own)])
        return Detection(likelihood, maps.map_mask(folder, names, likelihood, deciding), {})

    return look


def _view_size(dataset: Dataset, item: Item, size: tuple[int, int]) -> list[tuple[int, int]]:
    if dataset.view is None:
        return []
    height, width = dataset.view(item, torch.zeros(size)).shape
    return [(height, width)]


# --- the floor that data sets teach -----------------------------------------------------


def mean_masks(dataset: Dataset, mean_from: Dataset | None) -> dict[str, Tensor]:
    """The mean masks for prior:mean, by drive; empty where there is nothing to learn from.

    Raises ConfigError for a second set where the drives of the first teach each other.
    """
    groups = dataset.groups()
    if mean_from is None:
        taught = len(groups) - len(dataset.left_out) > 1
        return means_of_others(road_shares(dataset), dataset.left_out) if taught else {}
    if len(groups) > 1:
        what = f"is not for {dataset.name}, whose drives teach each other"
        raise ConfigError("--mean-from", what, "leave it out")
    mean = mean_of(road_shares(mean_from))
    return {group: mean for group in groups or [""]}


def mean_floor(masks: Mapping[str, Tensor]) -> Contender:
    """The floor ``prior:mean``; masks: (h,w) by drive ("" without)."""
    return Contender(MEAN, partial(_mean_look, masks), {}, MEAN_THRESHOLD, is_floor=True)


def _mean_look(masks: Mapping[str, Tensor], _: Dataset) -> Look:
    return lambda image, item: mean_detection(image, item, masks)


def mean_detection(image: Tensor, item: Item, masks: Mapping[str, Tensor]) -> Detection:
    """What the mask of the item's drive says, at the image's size."""
    mask = masks[item.group or ""]
    likelihood = resize(mask, image.shape[1:]).to(torch.float32).clamp(0, 1)
    return Detection(likelihood, likelihood >= MEAN_THRESHOLD, {})
