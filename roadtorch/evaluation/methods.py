"""Who is scored: detectors by name, weights, configs, maps made elsewhere, and baselines."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

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
from roadtorch.imaging.resize import size_of
from roadtorch.io.bounded import printable
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import load_network
from roadtorch.runtime.shipped_configs import SUFFIX, THRESHOLDS, config_file
from roadtorch.settings import read_settings_file

BASELINES = ("prior:rows", "prior:triangle")  # in every run; prior:mean joins where it can

MEAN = "prior:mean"  # the evaluator's own

MEAN_THRESHOLD = 0.5  # road at this place in at least half of the pictures

BY_NETWORK = {
    PictureNetwork.kind: "fusion",
    BackboneNetwork.kind: "fusion",
    PatchNetwork.kind: "layout:cnn-7",
}
"""The detector that weights alone stand for, by the kind of their network."""

Look = Callable[[Tensor, Item], Detection]


@dataclass(frozen=True)
class Method:
    """One detector of a run.

    prepare: makes it ready to look at a set's pictures; it travels to processes. settings:
    all of them but the threshold, as JSON can hold them. threshold: its default one.
    is_baseline: whether it never looks at the picture.
    """

    name: str
    prepare: Callable[[Dataset], Look] = field(repr=False)
    settings: Mapping[str, Any] = field(default_factory=dict)
    threshold: float = 0.5
    is_baseline: bool = False


def methods_for(
    dataset: Dataset,
    detectors: Sequence[str],
    settings: Mapping[str, Any],
    folders: Mapping[str, Path],
    mean_from: Dataset | None,
) -> list[Method]:
    """The detectors, those that give maps from folders, and the baselines, in this order.

    detectors: names, with wildcards. settings: values for all that are named. folders: by
    name, maps made elsewhere. mean_from: the set that teaches ``prior:mean``.
    Raises ConfigError for whatever can be refused before the run.
    """
    chosen = expand_names(detectors)
    methods = [named_detector(name, settings) for name in chosen]
    methods += [named_detector(name, {}) for name in BASELINES if name not in chosen]
    methods += [maps_from(name, folder) for name, folder in folders.items()]
    masks = mean_masks(dataset, mean_from)
    return [*methods, mean_baseline(masks)] if masks else methods


def expand_names(names: Sequence[str]) -> list[str]:
    """Detector names with wildcards expanded, each once, in the order given.

    The hundreds of a grid need its family: ``oneclass:*:HS``, see ``list_detectors``.
    Raises ConfigError for a name or a pattern that fits nothing.
    """
    known: dict[str, None] = {}
    for name in names:
        if name != MEAN:
            matches = list_detectors(name) if is_pattern(name) else [detector_entry(name).name]
            known.update(dict.fromkeys(matches))
    return list(known)


def candidate(text: str, letter: str) -> Method:
    """The method that a text stands for, called ``LETTER:NAME``.

    text: a weight file, what ``--config`` takes, a folder of likelihood maps, or the name of
    a detector. Raises ConfigError for anything else; WeightsError and InputError for a file that
    cannot be used.
    """
    path, detector, values = Path(text), text, {}
    called = f"{path.resolve().parent.name}-{path.stem}"  # many files are called weights
    if path.is_dir():
        called = path.resolve().name
    elif path.suffix == ".safetensors":
        detector, values = BY_NETWORK[load_network(path).kind], {"weights": {"file": text}}
    elif path.suffix == SUFFIX or text.startswith(THRESHOLDS):
        values = read_settings_file(config_file(text))
        detector = str(values.pop("detector", "fusion"))
    elif text not in list_detectors() and ("/" in text or path.suffix):
        what = "is no weight file, config, folder of maps or detector"
        raise ConfigError(text, what, "check the name")
    else:
        called = text
    method = maps_from("", path) if path.is_dir() else named_detector(detector, values)
    return replace(method, name=f"{letter}:{printable(called)}")


# --- detectors --------------------------------------------------------------------------


def named_detector(name: str, values: Mapping[str, Any]) -> Method:
    """A detector of the catalogue; ConfigError for settings that it does not have."""
    entry = detector_entry(name)
    settings = entry.configured(values).model_dump(mode="json")
    threshold = settings.pop("threshold")
    return Method(name, partial(_load, name, values), settings, threshold, entry.baseline)


def _load(name: str, values: Mapping[str, Any], _: Dataset) -> Look:
    detector = load_detector(name, **values)
    return lambda image, item: detector.detect(image)


# --- maps -------------------------------------------------------------------------------


def maps_from(name: str, folder: Path) -> Method:
    """Likelihood maps in a folder, as ``maps:NAME``, judged as config.toml beside them says.

    Raises ConfigError or InputError for a config.toml that cannot be used.
    """
    deciding = maps.deciding_settings(folder)
    settings: dict[str, Any] = {"folder": str(folder)}
    if maps.is_of_infer(folder):
        settings["isolated"] = deciding.isolated
    prepare = partial(_read_maps, folder, deciding)
    return Method(f"maps:{name}", prepare, settings, deciding.threshold)


def _read_maps(folder: Path, deciding: DetectorSettings, dataset: Dataset) -> Look:
    def look(image: Tensor, item: Item) -> Detection:
        sizes = [size_of(image)]
        if dataset.view is not None:
            height, width = dataset.view(item, torch.zeros(sizes[0])).shape
            sizes.append((height, width))
        # What infer makes is named like the picture, from its own folder or from that of the set;
        # what KITTI's server takes is named like the label.
        like_picture = str(PurePath(item.name).with_name(item.image.stem))
        names = list(dict.fromkeys([item.name, like_picture, item.label.stem]))
        if item.image.is_relative_to(dataset.root):
            names.append(str(item.image.relative_to(dataset.root).with_suffix("")))
        likelihood = maps.map_likelihood(folder, names, sizes)
        return Detection(likelihood, maps.map_mask(folder, names, likelihood, deciding), {})

    return look


# --- the baseline that data sets teach: the mean road mask of other groups ----------------


def mean_masks(dataset: Dataset, mean_from: Dataset | None) -> dict[str, Tensor]:
    """The mean masks for prior:mean, by group; empty where there is nothing to learn from.

    Raises ConfigError for a second set where the groups of the first teach each other.
    """
    groups = dataset.groups()
    if mean_from is None:
        taught = len(groups) - len(dataset.left_out) > 1
        return means_of_others(road_shares(dataset), dataset.left_out) if taught else {}
    if len(groups) > 1:
        what = f"is not for {dataset.name}, whose groups teach each other"
        raise ConfigError("--mean-from", what, "leave it out")
    return dict.fromkeys(groups or [""], mean_of(road_shares(mean_from)))


def road_shares(dataset: Dataset) -> dict[str, Tensor]:
    """How often each pixel is road, by group: float64 (H,W) in [0,1] ("" without groups).

    The share of a group's pictures that show road at that place, among those that have
    truth there. All are brought to the size of the set's first label.
    """
    road: dict[str, Tensor] = {}
    valid: dict[str, Tensor] = {}
    size: torch.Size | None = None
    for item in dataset.items:
        truth = dataset.truth(item)
        group, size = item.group or "", size or truth.road.shape
        for sums, mask in ((road, truth.road), (valid, truth.valid)):
            sums[group] = sums.get(group, 0) + resize(mask.to(torch.float64), size)
    return {group: road[group] / valid[group].clamp(min=1e-9) for group in road}


def mean_of(shares: Mapping[str, Tensor]) -> Tensor:
    """The mean over groups, each with the same weight as in the headline figures."""
    return torch.stack(list(shares.values())).mean(0).clamp(0, 1)


def means_of_others(
    shares: Mapping[str, Tensor], left_out: Collection[str] = ()
) -> dict[str, Tensor]:
    """For every group the mean of the other ones; empty when there is no other one.

    left_out: groups that teach nobody.
    """
    teachers = {name: share for name, share in shares.items() if name not in left_out}
    if len(teachers) < 2:
        return {}
    return {
        group: mean_of({name: share for name, share in teachers.items() if name != group})
        for group in shares
    }


def mean_baseline(masks: Mapping[str, Tensor]) -> Method:
    """The baseline ``prior:mean``; masks: (h,w) by group ("" without)."""
    return Method(MEAN, partial(_mean_look, masks), {}, MEAN_THRESHOLD, is_baseline=True)


def _mean_look(masks: Mapping[str, Tensor], _: Dataset) -> Look:
    def look(image: Tensor, item: Item) -> Detection:
        likelihood = resize(masks[item.group or ""], image.shape[1:]).to(torch.float32)
        likelihood = likelihood.clamp(0, 1)
        return Detection(likelihood, likelihood >= MEAN_THRESHOLD, {})

    return look


def resize(values: Tensor, size: tuple[int, int] | torch.Size) -> Tensor:
    """Bring a map (H,W) to another size, linearly."""
    if values.shape == tuple(size):
        return values
    return functional.interpolate(values[None, None], size=tuple(size), mode="bilinear")[0, 0]
