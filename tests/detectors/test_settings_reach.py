"""Settings of the built-in detectors: every one of them changes a result."""

from collections.abc import Iterator
from functools import cache
from inspect import get_annotations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args

import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.base.image import write_mask
from roadtorch.base.settings import Settings, build_settings, find_settings_group, merge
from roadtorch.camera.ground import pinhole_lens
from roadtorch.detectors.catalogue import detector_entry, load_detector
from roadtorch.oneclass import CLASSIFIERS
from tests.networks import write_random_network
from tests.representatives import distinct_detectors
from tests.streets import saturated_street


@cache
def street() -> Tensor:
    return saturated_street(dusk=0.6)


FILES = TemporaryDirectory()


GRID = "oneclass"


def one_of_each() -> list[str]:
    """List every way of working that can be set; of the one-class grid one for each classifier."""
    names = [name for name in distinct_detectors() if name.partition(":")[0] not in ("prior", GRID)]
    cells = [f"{GRID}:{name}:{'HSV' if name == 'pca' else 'HS'}" for name in CLASSIFIERS]
    return names + cells


QUICK: dict[str, dict] = {"working": {"rows": 48}, "dictionary": {"bases": 20, "rounds": 3}}
USUAL = {
    **dict.fromkeys(("ufl", "kmeans-road"), QUICK),
    "vanishing-point": {"working": {"pixels": 3000}, "gabor": {"orientations": 16, "scales": 2}},
    "oneclass:mog_opt:HS": {},
    "oneclass:dlp:HS": {},
    "fusion": {},
    "fusion:bayes": {},
    "fusion:paper": {},
}
"""What is set throughout, to be quick."""
NEEDS: dict[str, dict] = {
    "seed_area": {"isolated": "drop"},
    "tree.top": {"tree": {"min_area": 1}},
    "road.apex": {"road": {"position": "ahead"}},
    "road.base": {"road": {"position": "ahead"}},
    "road.whole": {"tree": {"nodes": "runs", "min_area": 1000}},
    "saturation": {"descriptor": "cpf:v2"},
    "classifier.threshold": {"classifier": {"rejected": 0.3}},
}
"""What else has to be set for a setting to matter, in the detectors of ``USUAL``."""


WITHOUT = {
    "vanishing-point": ("isolated", "seed_area", "outlines"),
    "labeller:untuned": ("seed_area",),
}
"""Settings without effect: the road is one region, with straight sides in `vanishing-point`."""


def wide_lens() -> dict[str, Any]:
    """Return the values of a fisheye for the street, 128×96 pixels."""
    pinhole = pinhole_lens(128, 96, 90).model_dump(exclude_none=True)
    return pinhole | {"model": "equidistant", "coefficients": (0.0,) * 4}


KNOWN: dict[tuple[str, ...], Any] = {
    ("ego", "outline"): [0.5, 0.8],
    ("working", "pixels"): 2000,
    ("invariant_angle",): 30.0,
    ("rectification",): {"lens": wide_lens(), "pitch": 10.0},
}
"""Values that no type or bound tells."""


def leaves(tree: dict, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], object]]:
    """Return the values of nested settings with their paths."""
    values: list[tuple[tuple[str, ...], object]] = []
    for key, value in tree.items():
        full = (*path, key)
        values += leaves(value, full) if isinstance(value, dict) else [(full, value)]
    return values


def nested(path: tuple[str, ...], value: object) -> dict:
    for key in reversed(path):
        value = {key: value}
    assert isinstance(value, dict)
    return value


def declared_in(kind: type[Settings], path: tuple[str, ...]) -> type:
    """Return the class that declares a setting; detectors that share it share its code."""
    group = find_settings_group(kind, path[:-1])
    return next(kind for kind in group.__mro__ if path[-1] in get_annotations(kind))


def candidates(name: str, path: tuple[str, ...], default: Any) -> Iterator[Any]:
    """Values for a setting, by its type, its bounds and its default; some are not allowed."""
    field = find_settings_group(detector_entry(name).settings, path[:-1]).model_fields[path[-1]]
    if path == ("weights", "file"):
        kind: Any = type(load_detector(name).analysis.network)
        yield str(write_random_network(Path(FILES.name) / f"{kind.kind}.safetensors", 0, kind))
    elif path == ("ego", "mask"):  # in the lower half of the street
        write_mask(Path(FILES.name) / "ego.png", (torch.arange(96) >= 48)[:, None].expand(96, 128))
        yield f"{FILES.name}/ego.png"
    elif path in KNOWN:
        yield KNOWN[path]
    elif isinstance(default, tuple):
        yield list(default[:2])
    elif isinstance(default, str):
        yield from get_args(field.annotation)
    else:
        near = (default / 4, 4 * default, default + 0.3, default + 7, default - 0.3, 50 * default)
        yield from (type(default)(value) for value in near)
        for limit in field.metadata:
            yield from (getattr(limit, way) for way in ("ge", "le") if hasattr(limit, way))


@cache
def images() -> tuple[Tensor, ...]:
    """Return the street, and coloured blocks, in which all results are scattered."""
    blocks = (torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(seed)) for seed in (1, 3))
    return street(), *(block.repeat_interleave(8, 1).repeat_interleave(8, 2) for block in blocks)


def maps(name: str, number: int, values: dict) -> list[Tensor]:
    detection = load_detector(name, **values).detect(images()[number])
    doubt = torch.tensor(bool(detection.doubt))
    return [detection.likelihood, detection.mask, doubt, *detection.cues.values()]


def need_of(name: str, path: tuple[str, ...]) -> str:
    """Return the key of ``NEEDS`` for a setting; "" where it needs nothing."""
    keys = (key for key in NEEDS if ".".join(path).startswith(key))
    return next(keys, "") if name in USUAL else ""


def usual_settings(name: str, need: str) -> dict:
    return merge(USUAL.get(name, {}), NEEDS.get(need, {}))


@cache
def thresholds(name: str, number: int, need: str) -> tuple[float, ...]:
    """Thresholds under which a detector finds little, some and much road."""
    likelihood = maps(name, number, usual_settings(name, need))[0]
    return tuple(likelihood.quantile(torch.tensor([0.2, 0.5, 0.7, 0.85, 0.95])).tolist())


@cache
def usual(name: str, number: int, need: str, threshold: float) -> list[Tensor]:
    return maps(name, number, usual_settings(name, need) | {"threshold": threshold})


def reaches(name: str, path: tuple[str, ...], value: Any) -> bool:
    """Return whether a value changes a detector's result in an image at a threshold."""
    need = need_of(name, path)

    def changes(number: int, threshold: float) -> bool:
        unchanged = usual(name, number, need, threshold)
        settings = usual_settings(name, need) | {"threshold": threshold}
        changed = maps(name, number, merge(settings, nested(path, value)))
        pairs = zip(unchanged, changed, strict=False)
        return len(unchanged) != len(changed) or not all(torch.equal(*pair) for pair in pairs)

    # What the mask alone depends on shows where there are several regions.
    of_mask = path[0] in ("isolated", "seed_area")
    return any(
        changes(number, threshold)
        for number in range(len(images()))[:: -1 if of_mask else 1]
        for threshold in thresholds(name, number, need)[slice(None) if of_mask else slice(1)]
    )


def is_allowed(name: str, path: tuple[str, ...], value: Any) -> bool:
    try:
        build_settings(detector_entry(name).settings, nested(path, value))
    except ConfigError:
        return False
    return True


SHOWS_ALL = "oneclass:mog2:HS"
"""The detector of the grid that shows what all of it share; the others show their classifier."""

Claim = dict[tuple[str, ...], Any]
"""Settings with their defaults of which one at least must reach the result."""


def claims() -> dict[str, list[Claim]]:
    """Return by detector each setting alone; those of a group that an earlier one covers, together.

    Inside they share the code; only that the group is passed on remains to be tested.
    """
    covered: set[type] = set()
    by_detector: dict[str, list[Claim]] = {}
    for name in one_of_each():
        kind = detector_entry(name).settings
        groups: dict[type, Claim] = {}
        for path, default in leaves(detector_entry(name).make_settings({}).model_dump()):
            if path[0] in WITHOUT.get(name, ()):
                continue
            if name == SHOWS_ALL or "oneclass" not in name or path[0] == "classifier":
                groups.setdefault(declared_in(kind, path), {})[path] = default
        by_detector[name] = []
        for owner, claim in groups.items():
            one_by_one = [{path: default} for path, default in claim.items()]
            by_detector[name] += [claim] if owner in covered else one_by_one
        covered |= groups.keys()
    return by_detector


CLAIMS = claims()


@pytest.mark.parametrize("name", CLAIMS)
def test_every_setting_reaches_the_result(name: str) -> None:
    def is_seen(claim: Claim) -> bool:
        return any(
            reaches(name, path, value)
            for path, default in claim.items()
            for value in candidates(name, path, default)
            if value != default and is_allowed(name, path, value)
        )

    assert [list(claim) for claim in CLAIMS[name] if not is_seen(claim)] == []
