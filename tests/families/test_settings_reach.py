"""Every setting of the built-in detectors changes what they find, and wrong ones are refused."""

from functools import cache

import pytest
import torch
from torch import Tensor

from roadtorch.detectors import load_detector
from roadtorch.errors import ConfigError
from tests.families.streets import lost_highlights


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
CHANGES: dict[str, dict] = {
    "cpf": {**DECISION, "superpixels": CUT, "texture": TEXTURE},
    "cpf:v2": {**DECISION, "superpixels": CUT, "texture": TEXTURE, "saturation": SATURATION},
    "cpf:squares": {**DECISION, "square": 5, "texture": TEXTURE},
    "grey-uniformity": {**DECISION, "superpixels": CUT, "bins": 8, "even": 0.9},
    "lbp": {**DECISION, "superpixels": CUT, "patterns": "smallest"},
    "labeller": {**DECISION, "superpixels": CUT, "labeller": LABELLER},
    "fusion": {
        **DECISION,
        "superpixels": CUT,
        "labeller": LABELLER,
        "texture": TEXTURE,
        "saturation": SATURATION,
        "road": ROAD,
    },
}


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


EACH = [(name, path, value) for name, tree in CHANGES.items() for path, value in leaves(tree)]


@cache
def pictures() -> tuple[Tensor, ...]:
    """The street, and coloured blocks, in which whatever is found lies scattered."""
    blocks = (torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(seed)) for seed in (1, 3))
    return street(), *(block.repeat_interleave(8, 1).repeat_interleave(8, 2) for block in blocks)


@cache
def thresholds(name: str, number: int) -> tuple[float, ...]:
    """Thresholds under which a detector finds little, some and much road."""
    shares = torch.tensor([0.2, 0.5, 0.7, 0.85, 0.95])
    return tuple(
        load_detector(name).detect(pictures()[number]).likelihood.quantile(shares).tolist()
    )


def maps(name: str, number: int, values: dict) -> list[Tensor]:
    found = load_detector(name, **values).detect(pictures()[number])
    return [found.likelihood, found.mask, *found.cues.values()]


@cache
def usual(name: str, number: int, threshold: float) -> list[Tensor]:
    return maps(name, number, {"threshold": threshold})


@pytest.mark.parametrize(
    ("name", "path", "value"), EACH, ids=[f"{name} {'.'.join(path)}" for name, path, _ in EACH]
)
def test_every_setting_reaches_the_result(name: str, path: tuple[str, ...], value: object) -> None:
    def changes(number: int, threshold: float) -> bool:
        before = usual(name, number, threshold)
        after = maps(name, number, {"threshold": threshold, **nested(path, value)})
        return not all(torch.equal(one, two) for one, two in zip(before, after, strict=True))

    # What the mask alone depends on (isolated, seed) shows where there are several regions.
    assert any(
        changes(number, threshold)
        for number in range(len(pictures()))
        for threshold in thresholds(name, number)
    )


@pytest.mark.parametrize("name", CHANGES)
def test_no_setting_is_left_out_above(name: str) -> None:
    every = {path for path, _ in leaves(load_detector(name).settings.model_dump())}

    assert {path for path, _ in leaves(CHANGES[name])} == every


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
    ],
)
def test_settings_out_of_range_are_refused_by_their_full_name(
    name: str, path: tuple[str, ...], value: object
) -> None:
    with pytest.raises(ConfigError) as refused:
        load_detector(name, **nested(path, value))

    assert refused.value.where.startswith(".".join(path))
