"""Contenders of an evaluation: detectors by name, weights, configs, likelihood maps, baselines."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import torch
from pydantic import BaseModel, Field
from torch import Tensor
from torch.nn import functional

from roadtorch.base.bounded import to_printable
from roadtorch.base.documents import read_document
from roadtorch.base.errors import ConfigError, DatasetError, InputError
from roadtorch.base.settings import (
    CONFIG_SUFFIX,
    THRESHOLDS_PREFIX,
    find_config,
    list_shipped_configs,
    merge,
    read_settings_file,
)
from roadtorch.camera.camera import Camera
from roadtorch.data import likelihood_maps
from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.detectors.catalogue import detector_entry, is_pattern, list_detectors, load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.entry import DetectorSettings
from roadtorch.imaging.resize import spatial_size
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.runtimes import REFERENCE
from roadtorch.layout.weights import load_network
from roadtorch.run.loop import Inference

BASELINES = ("prior:rows", "prior:triangle")  # always scored; prior:mean where it can be computed
MEAN_PRIOR = "prior:mean"  # not in the catalogue, as it needs the set
MEAN_THRESHOLD = 0.5  # the pixel is road in at least half of the images

DETECTOR_BY_NETWORK = {
    BackboneNetwork.kind: "fusion",
    PatchNetwork.kind: "layout:cnn-7",
}
"""Detector that runs a weight file on its own, by the kind of its network."""

Predictor = Callable[[Tensor, LabelledItem], Detection]
"""Image and item → detection by a loaded contender; can be pickled for worker processes."""

MAX_NAME_LENGTH = 60  # letters of a name from a file in a message


@dataclass(frozen=True)
class Contender:
    """One method of an evaluation."""

    name: str
    prepare: Callable[[Dataset], Predictor] = field(repr=False)  # loads it for a set
    settings: Mapping[str, object] = field(default_factory=dict)  # all but the threshold, as JSON
    threshold: float = 0.5  # the default one
    is_baseline: bool = False  # whether it ignores the image
    earlier_threshold: float | None = None  # that an earlier run chose
    detector: str = ""  # name in the catalogue; empty for likelihood maps and prior:mean
    runtime: str = REFERENCE  # that computes its network


def collect_contenders(
    dataset: Dataset,
    detectors: Sequence[str | Contender],
    settings: Mapping[str, object],
    camera: Camera | None = None,
    mean_from: Dataset | None = None,
    with_baselines: bool = True,
) -> list[Contender]:
    """Return the contenders, each once, and the baselines, in this order.

    detectors: as in ``parse_contenders``. settings: values for all of them. camera: the one that
    took the images. mean_from: set that ``prior:mean`` is computed on.
    Raises ConfigError for mistakes that are found before the run.
    """
    entries: dict[str, Contender] = {}
    for text in detectors:
        named = [text] if isinstance(text, Contender) else parse_contenders(text, settings, camera)
        for entry in named:
            first = entries.setdefault(entry.name, entry)
            if (first.settings, first.threshold) != (entry.settings, entry.threshold):
                raise ConfigError(entry.name, "names two detectors", "write NAME=PATH")
    if (settings or camera is not None) and not any(entry.detector for entry in entries.values()):
        raise ConfigError("--set, --camera", "have no effect on maps", "leave them out")
    if with_baselines:
        for name in BASELINES:
            entries.setdefault(name, contender_from_name(name, {}))
        if masks := mean_masks(dataset, mean_from):
            predict = partial(_mean_mask, masks)
            entries[MEAN_PRIOR] = Contender(
                MEAN_PRIOR, lambda _: predict, threshold=MEAN_THRESHOLD, is_baseline=True
            )
    return list(entries.values())


def parse_reference(
    text: str, settings: Mapping[str, object], camera: Camera | None = None
) -> Contender:
    """Return the one contender that all others are compared with, as ``parse_contenders`` does."""
    matches = parse_contenders(text, settings, camera)
    if len(matches) != 1:
        raise ConfigError(text, "is not a single detector", "name one")
    return matches[0]


# --- detectors --------------------------------------------------------------------------


def parse_contenders(
    text: str, settings: Mapping[str, object] | None = None, camera: Camera | None = None
) -> list[Contender]:
    """Return the contenders that a text names.

    text: the name of a detector, with wildcards (the hundreds of a grid need its family:
    ``oneclass:*:HS``); or a weight file, a value of ``--config``, or a folder of likelihood maps,
    as PATH or NAME=PATH. Raises ConfigError for anything else, WeightsError and InputError for a
    file that cannot be used.
    """
    settings = settings or {}
    if text == MEAN_PRIOR:
        return []
    if is_pattern(text):
        return [contender_from_name(name, settings, camera) for name in list_detectors(text)]
    name, equals, file = text.partition("=")
    if not equals or os.path.exists(text):
        name, file = "", text
    path = Path(file)
    entry = None
    with suppress(ConfigError):
        entry = detector_entry(text)
    if entry is not None and not equals:
        return [contender_from_name(text, settings, camera)]
    if not name.isprintable() or set(name) & set("/\\"):
        raise ConfigError(text, f"{name!r} cannot be a file name", "choose another")
    is_shipped = file.startswith(THRESHOLDS_PREFIX) and file in list_shipped_configs()
    if os.path.isdir(file) and not is_shipped:
        return [contender_from_maps(name or to_printable(path.resolve().name), path)]
    if path.suffix == ".safetensors":
        detector, values = DETECTOR_BY_NETWORK[load_network(path).kind], {"weights": {"file": file}}
    elif path.suffix == CONFIG_SUFFIX or file.startswith(THRESHOLDS_PREFIX):
        values = read_settings_file(find_config(file))
        detector = str(values.pop("detector", "fusion"))
    elif equals or "/" in text or path.suffix:
        message = "is not a weight file, config, folder of maps or detector"
        raise ConfigError(text, message, "check the name")
    else:
        detector, values = text, {}  # not a detector: refused below
    entry = contender_from_name(detector, merge(values, settings), camera)
    by_file = f"{path.resolve().parent.name}-{path.stem}"  # many files are called weights
    return [replace(entry, name=name or to_printable(by_file))]


def contender_from_name(
    name: str, values: Mapping[str, Any], camera: Camera | None = None
) -> Contender:
    """Return a detector of the catalogue; raise ConfigError for settings that it does not have."""
    entry = detector_entry(name)
    if camera is not None:
        values = merge(camera.settings_for(entry.settings), values)
    settings = entry.make_settings(values).model_dump(mode="json", exclude_none=True)
    threshold = settings.pop("threshold")
    return Contender(
        name,
        lambda _: partial(_detect, load_detector(name, **values)),
        settings,
        threshold,
        entry.baseline,
        detector=name,
    )


def compute_with(entry: Contender, runtime: str) -> Contender:
    """Return a detector whose network a runtime computes; baselines and maps are unchanged."""
    if runtime == REFERENCE or entry.is_baseline or not entry.detector:
        return entry
    entry = replace(entry, runtime=runtime)
    return replace(entry, prepare=lambda _: partial(_detect, load_contender(entry)))


def load_contender(entry: Contender) -> Detector:
    """Load a detector of the catalogue with its settings, threshold and runtime."""
    values = {**entry.settings, "threshold": entry.threshold, "runtime": entry.runtime}
    return load_detector(entry.detector, **values)


def _detect(detector: Detector, image: Tensor, _: LabelledItem) -> Detection:
    return Inference(detector)(image)


# --- maps -------------------------------------------------------------------------------


def contender_from_maps(name: str, folder: Path) -> Contender:
    """Return likelihood maps in a folder as ``maps:NAME``, thresholded as its config.toml says."""
    decision = likelihood_maps.read_decision_settings(folder)
    settings: dict[str, object] = {"folder": str(folder)}
    if likelihood_maps.is_infer_folder(folder):
        settings["isolated"] = decision.isolated
    return Contender(
        f"maps:{name}",
        partial(_prepare_maps, folder, decision),
        settings,
        decision.threshold,
    )


def _prepare_maps(folder: Path, decision: DetectorSettings, dataset: Dataset) -> Predictor:
    """Return the reader of maps, all of which are read for the grey level of likelihood 1.

    Raises InputError without any map, and for a map that two images would share.
    """
    owners: dict[Path, str] = {}
    for item in dataset.items:
        for path in likelihood_maps.find_maps(folder, _map_names(dataset, item)):
            if (owner := owners.setdefault(path, item.name)) != item.name:
                problem = f"would be the map of {owner} and of {item.name}"
                raise InputError(path, problem, "keep maps in the folders that the images have")
    if not owners:
        problem = f"has a likelihood map of none of {len(dataset.items)} images"
        endings = ", NAME".join(likelihood_maps.MAP_ENDINGS)
        raise InputError(folder, problem, f"give a folder with NAME{endings}, or a detector")
    return partial(_read_maps, likelihood_maps.open_maps(folder, decision, [*owners]), dataset)


def _map_names(dataset: Dataset, item: LabelledItem) -> list[str]:
    """Return the possible stems of an item's map.

    Maps by infer are named like the image, relative to its folder or to that of the set; maps for
    KITTI's server are named like the label.
    """
    like_image = str(PurePath(item.name).with_name(item.image.stem))
    names = list(dict.fromkeys([item.name, like_image, item.label.stem]))
    if item.image.is_relative_to(dataset.root):
        names.append(str(item.image.relative_to(dataset.root).with_suffix("")))
    return names


def _read_maps(
    maps: likelihood_maps.MapFolder, dataset: Dataset, image: Tensor, item: LabelledItem
) -> Detection:
    sizes = [spatial_size(image)]
    if dataset.scoring_space is not None:
        height, width = dataset.scoring_space(item, torch.zeros(sizes[0])).shape
        sizes.append((height, width))
    names = _map_names(dataset, item)
    likelihood = maps.read_likelihood(names, sizes)
    return Detection(likelihood, maps.read_mask(names, likelihood), {})


# --- the baseline prior:mean: the mean road mask of other groups --------------------------


def mean_masks(dataset: Dataset, mean_from: Dataset | None = None) -> dict[str, Tensor]:
    """Compute the mean masks (H, W) of prior:mean, by group ("" without groups).

    The mask of a group is the mean over the other groups, without those left out; empty where there
    are no others. Raises ConfigError for a second set where the first one has groups.
    """
    groups = sorted({item.group or "" for item in dataset.items})
    if mean_from is not None:
        if len(groups) > 1:
            message = f"is for sets without groups, and {dataset.name} has groups"
            raise ConfigError("--mean-from", message, "leave it out")
        return dict.fromkeys(groups, _mean(road_frequencies(mean_from).values()))
    if len(groups) - len(dataset.left_out) < 2:
        return {}
    frequencies = road_frequencies(dataset)
    counted = frequencies.keys() - dataset.left_out
    return {
        group: _mean(frequencies[name] for name in frequencies if name in counted - {group})
        for group in frequencies
    }


def road_frequencies(dataset: Dataset) -> dict[str, Tensor]:
    """Compute how often each pixel is road, by group: float64 (H, W) in [0, 1] ("" without groups).

    It is the fraction among the group's images with truth at that pixel. All are resized to the
    size of the set's first label; one that cannot be read fails where it is scored.
    """
    road: dict[str, Tensor] = {}
    valid: dict[str, Tensor] = {}
    size: torch.Size | None = None
    for item in dataset.items:
        with suppress(DatasetError):
            truth = dataset.truth(item)
            group, size = item.group or "", size or truth.road.shape
            for sums, mask in ((road, truth.road), (valid, truth.valid)):
                sums[group] = sums.get(group, 0) + resize_map(mask.to(torch.float64), size)
    return {group: road[group] / valid[group].clamp(min=1e-9) for group in road}


def _mean(frequencies: Iterable[Tensor]) -> Tensor:
    """Return the mean over groups, each with the same weight as in the headline scores."""
    return torch.stack(list(frequencies)).mean(0).clamp(0, 1)


def _mean_mask(masks: Mapping[str, Tensor], image: Tensor, item: LabelledItem) -> Detection:
    likelihood = resize_map(masks[item.group or ""], image.shape[1:]).to(torch.float32).clamp(0, 1)
    return Detection(likelihood, likelihood >= MEAN_THRESHOLD, {})


def resize_map(values: Tensor, size: tuple[int, int] | torch.Size) -> Tensor:
    """Resize a map (H, W) bilinearly."""
    if values.shape == tuple(size):
        return values
    return functional.interpolate(values[None, None], size=tuple(size), mode="bilinear")[0, 0]


# --- thresholds of an earlier run -------------------------------------------------------


class _EarlierScores(BaseModel):
    maxf_threshold: float | None = Field(ge=0, le=1, allow_inf_nan=False)
    settings: dict[str, object] = {}


class _EarlierRun(BaseModel):
    detectors: dict[str, _EarlierScores]


def apply_thresholds(entries: Sequence[Contender], path: Path) -> list[Contender]:
    """Return the contenders with the thresholds that an earlier run chose on all its groups.

    path: its metrics.json. Raises DatasetError for another file; ConfigError when the run lacks the
    detector or had other settings: a threshold is not valid for another detector.
    """
    with read_document(path, "give a metrics.json that evaluate wrote") as data:
        earlier = _EarlierRun.model_validate_json(data).detectors
    chosen: list[Contender] = []
    for entry in entries:
        scores = earlier.get(entry.name)
        if scores is None or scores.maxf_threshold is None:
            names = sorted(name for name in earlier if earlier[name].maxf_threshold is not None)
            listed = ", ".join(name[:MAX_NAME_LENGTH] for name in names[:10])
            raise ConfigError(path, f"has no threshold for {entry.name}", f"it has {listed}")
        if scores.settings != entry.settings:
            message = f"chose the threshold of {entry.name} with other settings"
            raise ConfigError(path, message, "run both with the same --set")
        chosen.append(replace(entry, earlier_threshold=scores.maxf_threshold))
    return chosen
