"""Every setting of the built-in detectors changes what they find, and wrong ones are refused."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import torch
from torch import Tensor

from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import save_network
from roadtorch.oneclass import CLASSIFIERS
from tests.detectors.streets import lost_highlights


@cache
def street() -> Tensor:
    return lost_highlights(dusk=0.6)


DECISION = {
    "threshold": 0.9,
    "isolated": "keep",
    "seed": {"height": 240, "width": 320},
    "working": {"pixels": 2000},
}
CUT = {"pixels": 900, "compactness": 20.0}
WIDTHS = {
    "lightness": 0.5,
    "chroma": 0.3,
    "gradient": 0.01,
    "contrast": 0.02,
    "row": 0.3,
    "column": 0.2,
}
LABELLER = {
    "exposure": {"ground": 0.8},
    "place": {
        "horizon": 0.3,
        "sky_rise": 0.4,
        "sky_slope": 0.1,
        "sky_softness": 0.1,
        "ground_drop": 0.3,
        "ground_slope": 0.9,
        "ground_softness": 0.05,
        "vertical": 4.0,
    },
    "bandwidths": WIDTHS,
    "order": {"weight": 0.5, "change": 0.4, "breach": 0.2, "step": 3},
    "sharpness": 0.3,
    "rounds": 1,
    "margin": 0.95,
    "support": "maximum",
}
TEXTURE = {"planes": ["R", "O1"], "ridge": 10.0, "bins": 8, "tail": 0.2, "even": 0.9}
ROAD = {
    "place": {"weight": 3.0, "apex": 0.3, "narrow": 0.3, "spread": 0.4, "softness": 0.5},
    "weights": {"layout": 3.0, "distance": 3.0, "texture": 0.1, "look": 0.1, "neighbours": 0.1},
    "reach": 1.0,
    "bandwidths": WIDTHS,
    "bias": 2.0,
    "temperature": 1.0,
    "rounds": 1,
}
SATURATION = {"dark": 0.5, "bright": 0.6, "least": 0.95}
UFL: dict[str, dict] = {
    "seed": DECISION["seed"],
    "working": {"rows": 40, "widest": 1.0},
    "smoothing": {"sigma": 2.5, "reach": 1, "light_sigma": 2.0, "light_reach": 1, "target": 1.0},
    "dictionary": {
        "side": 5,
        "contrast": 0.1,
        "whitening": 1.0,
        "bases": 15,
        "rounds": 1,
        "start": "patches",
        "random_seed": 1,
    },
    "maps": {"encoder": "patch", "row_weights": "from_one", "share": 0.4, "scale": "none"},
    "tree": {"levels": 5, "top": "left_out", "least": 100},
    "road": {
        "weight": 0.5,
        "rounds": 1,
        "place": "from_one",
        "apex": 0.2,
        "base": 1.0,
        "centring": "none",
        "kept": 0.3,
        "error_range": "everywhere",
        "model": "best",
        "whole": "never",
        "dilation": 5,
    },
}
ONE_CLASS = {  # what all have, shown with one of them
    "threshold": 0.9,
    "isolated": "drop",
    "working": {"pixels": 2000},
    "seed": {"height": 120, "width": 20},
    "samples": {
        "reduction": "grid",
        "segments": 10,
        "central": "medoid",
    },
    "random": 7,
}
BOUNDS = {"rejected": 0.5, "hue": "linear"}
BINS = {**BOUNDS, "bins": 8, "planes": "product"}
NOISE = {**BINS, "noise": 0.3, "edge": "clip"}
GAUSSIAN = {**BOUNDS, "ridge": 0.5, "threshold": "chi2"}
MIXTURE = {**BOUNDS, "components": 3, "restarts": 1, "formula": "paper"}
CENTRES = {**BOUNDS, "centres": 2, "restarts": 1}
CLASSIFIER = {
    "nn:HS": {**BOUNDS, "reading": "ratio"},
    "hist64_s:HS": BINS,
    "hist64_sn:HS": NOISE,
    "hist100_s:HS": BINS,
    "hist100_sn:HS": NOISE,
    "gaussian:HS": GAUSSIAN,
    "robust_gaussian:HS": {**GAUSSIAN, "method": "trim"},
    "mog2:HS": MIXTURE,
    "mog4:HS": MIXTURE,
    "mog_opt:HS": {**MIXTURE, "select": "cv"},
    "svdd:HS": {**BOUNDS, "sigma": 0.1, "threshold": "quantile"},
    "pca:HSV": {**BOUNDS, "variance": 0.1, "full": "mean"},
    "mpm:HS": {**BOUNDS, "kernel": "linear", "sigma": 0.1, "ridge": 1.0},
    "mst:HS": BOUNDS,
    "dlp:HS": {**BOUNDS, "dissimilarity": "euclid", "threshold": "quantile"},
    "kmeans:HS": CENTRES,
    "kcentres:HS": CENTRES,
}
FUSION = {
    **DECISION,
    "superpixels": CUT,
    "labeller": LABELLER,
    "texture": TEXTURE,
    "saturation": SATURATION,
    "road": ROAD,
}
WEIGHTS = TemporaryDirectory()


def other_weights(kind: type[PatchNetwork] | type[PictureNetwork]) -> str:
    """A file with weights that nobody trained."""
    path = Path(WEIGHTS.name) / f"{kind.kind}.safetensors"
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        save_network(path, kind(), {})
    return str(path)


SHOWS_ALL = "oneclass:mog2:HS"
CHANGES: dict[str, dict] = {
    "cpf": {**DECISION, "superpixels": CUT, "texture": TEXTURE},
    "cpf:v2": {**DECISION, "superpixels": CUT, "texture": TEXTURE, "saturation": SATURATION},
    "cpf:squares": {**DECISION, "square": 5, "texture": TEXTURE},
    "grey-uniformity": {**DECISION, "superpixels": CUT, "bins": 8, "even": 0.9},
    "lbp": {**DECISION, "superpixels": CUT, "patterns": "smallest"},
    "labeller": {**DECISION, "superpixels": CUT, "labeller": LABELLER},
    "layout": {
        **DECISION,
        "superpixels": CUT,
        "labeller": LABELLER,
        "weights": {"file": other_weights(PictureNetwork)},
        "share": 0.1,
    },
    "layout:cnn-7": {**DECISION, "weights": {"file": other_weights(PatchNetwork)}},
    "fusion:untrained": FUSION,
    "fusion": {
        **FUSION,
        "weights": {"file": other_weights(PictureNetwork)},
        "share": 0.1,
        "learned": {"weight": 4.0, "detail": 4.0},
    },
    "fusion:paper": {
        **DECISION,
        "superpixels": CUT,
        "weights": {"file": other_weights(PatchNetwork)},
        "texture": TEXTURE,
    },
    "ufl": {**UFL, "threshold": 0.9, "isolated": "keep", "tree": UFL["tree"] | {"nodes": "runs"}},
    "ufl:original": {
        **UFL,
        "threshold": 0.9,
        "isolated": "drop",
        "tree": UFL["tree"] | {"nodes": "regions"},
    },
    **{f"oneclass:{name}": {"classifier": own} for name, own in CLASSIFIER.items()},
}
CHANGES[SHOWS_ALL] |= ONE_CLASS
QUICK: dict[str, dict] = {"working": {"rows": 48}, "dictionary": {"bases": 20, "rounds": 3}}
USUAL = {"ufl": QUICK, "ufl:original": QUICK, "oneclass:mog_opt:HS": {}, "oneclass:dlp:HS": {}}
"""What is set throughout, to be quick."""
NEEDS: dict[str, dict] = {
    "seed": {"isolated": "drop"},
    "tree.top": {"tree": {"least": 1}},
    "road.apex": {"road": {"place": "ahead"}},
    "road.base": {"road": {"place": "ahead"}},
    "road.whole": {"tree": {"nodes": "runs", "least": 1000}},
    "classifier.restarts": {"classifier": {"select": "aic"}},
    "classifier.threshold": {"classifier": {"rejected": 0.3}},
}
"""What else has to be set for a setting to matter, in the detectors of ``USUAL``."""


def leaves(tree: dict, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], object]]:
    """The values of nested settings with their paths."""
    found: list[tuple[tuple[str, ...], object]] = []
    for key, value in tree.items():
        inside = leaves(value, (*path, key)) if isinstance(value, dict) else [((*path, key), value)]
        found += inside
    return found


def nested(path: tuple[str, ...], value: object) -> dict:
    for key in reversed(path):
        value = {key: value}
    assert isinstance(value, dict)
    return value


def merged(*trees: dict) -> dict:
    """Nested settings, later ones over earlier ones."""
    found: dict = {}
    for tree in trees:
        for key, value in tree.items():
            is_group = isinstance(value, dict)
            found[key] = merged(found.get(key, {}), value) if is_group else value
    return found


EACH = [(name, path, value) for name, tree in CHANGES.items() for path, value in leaves(tree)]


@cache
def pictures() -> tuple[Tensor, ...]:
    """The street, and coloured blocks, in which whatever is found lies scattered."""
    blocks = (torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(seed)) for seed in (1, 3))
    return street(), *(block.repeat_interleave(8, 1).repeat_interleave(8, 2) for block in blocks)


def maps(name: str, number: int, values: dict) -> list[Tensor]:
    found = load_detector(name, **values).detect(pictures()[number])
    return [found.likelihood, found.mask, *found.cues.values()]


def need_of(name: str, path: tuple[str, ...]) -> str:
    """The key of ``NEEDS`` that a setting falls under; "" where it needs nothing."""
    keys = (key for key in NEEDS if ".".join(path).startswith(key))
    return next(keys, "") if name in USUAL else ""


def usual_settings(name: str, need: str) -> dict:
    return merged(USUAL.get(name, {}), NEEDS.get(need, {}))


@cache
def thresholds(name: str, number: int, need: str) -> tuple[float, ...]:
    """Thresholds under which a detector finds little, some and much road."""
    likelihood = maps(name, number, usual_settings(name, need))[0]
    return tuple(likelihood.quantile(torch.tensor([0.2, 0.5, 0.7, 0.85, 0.95])).tolist())


@cache
def usual(name: str, number: int, need: str, threshold: float) -> list[Tensor]:
    return maps(name, number, usual_settings(name, need) | {"threshold": threshold})


@pytest.mark.parametrize(
    ("name", "path", "value"), EACH, ids=[f"{name} {'.'.join(path)}" for name, path, _ in EACH]
)
def test_every_setting_reaches_the_result(name: str, path: tuple[str, ...], value: object) -> None:
    need = need_of(name, path)

    def changes(number: int, threshold: float) -> bool:
        before = usual(name, number, need, threshold)
        settings = usual_settings(name, need) | {"threshold": threshold}
        after = maps(name, number, merged(settings, nested(path, value)))
        return not all(torch.equal(one, two) for one, two in zip(before, after, strict=True))

    # What the mask alone depends on (isolated, seed) shows where there are several regions.
    assert any(
        changes(number, threshold)
        for number in range(len(pictures()))
        for threshold in thresholds(name, number, need)
    )


@pytest.mark.parametrize("name", CHANGES)
def test_no_setting_is_left_out_above(name: str) -> None:
    every = {path for path, _ in leaves(load_detector(name).settings.model_dump())}

    shared = ONE_CLASS if name.startswith("oneclass:") else {}
    assert {path for path, _ in leaves(CHANGES[name] | shared)} == every


def test_every_kind_of_one_class_classifier_is_above() -> None:
    assert [name.split(":")[0] for name in CLASSIFIER] == list(CLASSIFIERS)


@pytest.mark.parametrize(
    ("name", "path", "value"),
    [
        ("cpf", ("texture", "bins"), 1),
        ("cpf", ("texture", "planes"), ["R", "nrr"]),
        ("cpf", ("texture", "planes"), []),
        ("cpf", ("texture", "tail"), 0.5),
        ("cpf:v2", ("saturation", "least"), 1.5),
        ("cpf:squares", ("square",), 1),
        ("lbp", ("patterns",), "round"),
        ("grey-uniformity", ("even",), 0.0),
        ("oneclass:nn:HS", ("classifier", "reading"), "near"),
        ("oneclass:mog2:HS", ("classifier", "components"), 0),
        ("oneclass:svdd:HS", ("classifier", "sigma"), 0.0),
        ("oneclass:svdd:HS", ("seed", "width"), 321),
        ("oneclass:gaussian:HS", ("random",), -1),
    ],
)
def test_settings_out_of_range_are_refused_by_their_full_name(
    name: str, path: tuple[str, ...], value: object
) -> None:
    with pytest.raises(ConfigError) as refused:
        load_detector(name, **nested(path, value))

    assert refused.value.where.startswith(".".join(path))
