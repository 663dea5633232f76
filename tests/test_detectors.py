"""What every registered detector keeps to, and the door that leads to them."""

from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

import pytest
import torch
from pydantic import Field
from torch import Tensor, nn

import roadtorch.plugins
from roadtorch.detector import Detection, Detector, Entry, Grid, checked_image, decide
from roadtorch.detectors import catalogue as catalogue_module
from roadtorch.detectors.catalogue import (
    detector_entry,
    detector_groups,
    list_detectors,
    load_detector,
    matching_detectors,
    register,
)
from roadtorch.errors import ConfigError, InputError
from roadtorch.settings import Settings
from tests.representatives import representatives

every_detector = pytest.mark.parametrize("name", representatives(list_detectors()))


@cache
def loaded(name: str) -> Detector:
    """Loaded once: the contract is about what detectors say, not about loading."""
    return load_detector(name)


def street(height: int, width: int, seed: int = 0) -> Tensor:
    """A noisy grey wedge under a pale sky: enough of a street for a contract."""
    generator = torch.Generator().manual_seed(seed)
    rows = torch.linspace(0, 1, height).view(-1, 1)
    columns = torch.linspace(-1, 1, width).view(1, -1)
    road = (rows > 0.45) & (columns.abs() < rows - 0.3)
    colours = torch.tensor([[0.7, 0.8, 0.95], [0.3, 0.45, 0.2], [0.45, 0.45, 0.47]])
    classes = torch.where(road, 2, (rows > 0.45).long().expand(height, width))
    noise = torch.randn(3, height, width, generator=generator) * 0.04
    return (colours[classes].permute(2, 0, 1) + noise).clamp(0, 1)


def check_detection(detection: Detection, height: int, width: int) -> None:
    likelihood, mask = detection.likelihood, detection.mask
    assert (likelihood.dtype, mask.dtype) == (torch.float32, torch.bool)
    assert likelihood.shape == mask.shape == (height, width)
    assert likelihood.isfinite().all()
    assert likelihood.min() >= 0
    assert likelihood.max() <= 1
    for name, cue in detection.cues.items():
        assert cue.shape[-2:] == (height, width), name
        assert cue.ndim in (2, 3), name
        assert not cue.is_floating_point() or cue.isfinite().all(), name
    if "layout" in detection.cues:
        assert detection.cues["layout"].shape == (3, height, width)


# --- the contract -------------------------------------------------------------------------


@every_detector
@pytest.mark.parametrize(
    ("height", "width"), [(16, 16), (17, 200), (61, 16), (64, 48), (241, 319), (240, 320)]
)
def test_any_size_gives_maps_of_that_size(name: str, height: int, width: int) -> None:
    check_detection(loaded(name).detect(street(height, width)), height, width)


@every_detector
@pytest.mark.parametrize("kind", ["black", "white", "flat", "grey"])
def test_pictures_without_anything_to_see_give_proper_maps(name: str, kind: str) -> None:
    image = {
        "black": torch.zeros(3, 48, 64),
        "white": torch.ones(3, 48, 64),
        "flat": torch.tensor([0.2, 0.5, 0.7]).view(3, 1, 1).expand(3, 48, 64),
        "grey": street(48, 64).mean(0, keepdim=True).expand(3, 48, 64),
    }[kind]

    check_detection(loaded(name).detect(image), 48, 64)


@every_detector
def test_the_same_image_gives_the_same_bytes_and_is_left_alone(name: str) -> None:
    image = street(96, 128)
    before = image.clone()

    torch.manual_seed(1)
    first = loaded(name).detect(image)
    torch.manual_seed(2)  # no detector may draw from torch's own generator
    second = load_detector(name).detect(image)

    assert torch.equal(image, before)
    assert torch.equal(first.likelihood, second.likelihood)
    assert torch.equal(first.mask, second.mask)
    assert first.cues.keys() == second.cues.keys()
    assert all(torch.equal(first.cues[key], second.cues[key]) for key in first.cues)


@every_detector
def test_a_batch_is_its_images_one_by_one(name: str) -> None:
    images = torch.stack([street(48, 64, seed) for seed in range(2)])

    batch = loaded(name)(images)

    singles = torch.stack([loaded(name).detect(image).likelihood for image in images])
    assert torch.equal(batch, singles)
    assert loaded(name)(images[:0]).shape == (0, 48, 64)


@every_detector
def test_saved_and_loaded_it_says_the_same(name: str) -> None:
    image = street(48, 64)
    copy = load_detector(name)

    copy.load_state_dict(loaded(name).state_dict())

    assert torch.equal(copy.detect(image).likelihood, loaded(name).detect(image).likelihood)


@every_detector
def test_the_mask_follows_the_threshold(name: str) -> None:
    image = street(96, 128)

    everything = load_detector(name, threshold=0.0).detect(image)
    detection = loaded(name).detect(image)

    assert everything.mask.all()
    threshold: float = getattr(loaded(name).settings, "threshold")  # noqa: B009
    assert not detection.mask[detection.likelihood < threshold].any()


def with_value(value: float) -> Tensor:
    image = street(32, 32)
    image[1, 5, 7] = value
    return image


@every_detector
@pytest.mark.parametrize(
    ("image", "what"),
    [
        (with_value(float("nan")), "has values from nan to nan"),
        (with_value(float("inf")), "has values from 0"),
        (with_value(1.5), "has values from 0"),
        (with_value(-0.5), "has values from -0.5"),
        (street(32, 32)[:1], "has the shape (1, 32, 32)"),
        (street(32, 32)[None], "has the shape (1, 3, 32, 32)"),
        (street(15, 15), "is 15×15 pixels"),
        (torch.zeros(3, 32, 0), "is 0×32 pixels"),
        (torch.zeros(3, 32, 32, dtype=torch.uint8), "is torch.uint8"),
        ([[0.5]], "is list"),
    ],
    ids=["nan", "inf", "bright", "negative", "grey", "batch", "small", "none", "bytes", "list"],
)
def test_what_is_no_image_is_refused(name: str, image: Any, what: str) -> None:
    with pytest.raises(InputError) as caught:
        loaded(name).detect(image)

    assert caught.value.where == "image"
    assert caught.value.what.startswith(what)


def test_a_batch_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match=r"images: have the shape \(3, 32, 32\)"):
        load_detector("prior:rows")(street(32, 32))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_floating_types_become_float32(dtype: torch.dtype) -> None:
    assert checked_image(street(16, 16).to(dtype)).dtype == torch.float32


# --- the door -----------------------------------------------------------------------------


class Simple(Settings):
    threshold: float = Field(default=0.5, ge=0, le=1)
    gain: float = 1.0


class Isolated(Simple):
    isolated: str = "drop"


def brightness(settings: Simple) -> Any:
    return lambda image: {"likelihood": image.mean(0) * settings.gain, "red": image[0]}


@pytest.fixture
def catalogue(monkeypatch: pytest.MonkeyPatch) -> dict[str, Entry]:
    """The catalogue of this test alone."""
    entries: dict[str, Entry] = {}
    monkeypatch.setattr(catalogue_module, "_catalogue", lambda: entries)
    return entries


def test_a_registered_detector_is_found_set_and_run(catalogue: dict[str, Entry]) -> None:
    register(Entry("bright", "mean of the channels", Simple, brightness))
    image = torch.full((3, 16, 16), 0.4)

    detection = load_detector("bright", gain=2).detect(image)

    assert list_detectors() == ["bright"]
    assert torch.equal(detection.likelihood, torch.full((16, 16), 0.8))
    assert detection.mask.all()
    assert list(detection.cues) == ["red"]


def test_a_name_is_given_once(catalogue: dict[str, Entry]) -> None:
    entry = Entry("bright", "", Simple, brightness)
    register(entry)

    with pytest.raises(ConfigError, match="bright: is the name of another detector"):
        register(entry)


def test_settings_without_a_threshold_are_refused(catalogue: dict[str, Entry]) -> None:
    with pytest.raises(ConfigError, match="without a threshold"):
        register(Entry("bright", "", Settings, brightness))


def test_weights_of_an_analysis_belong_to_the_detector(catalogue: dict[str, Entry]) -> None:
    class Learned(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.gain = nn.Parameter(torch.tensor(0.5))

        def forward(self, image: Tensor) -> dict[str, Tensor]:
            return {"likelihood": image.mean(0) * self.gain}

    register(Entry("learned", "", Simple, lambda settings: Learned()))
    detector = load_detector("learned")

    assert list(detector.state_dict()) == ["analysis.gain"]
    assert not detector.detect(torch.ones(3, 16, 16)).likelihood.requires_grad


def test_regions_away_from_the_seed_area_are_dropped_when_asked() -> None:
    likelihood = torch.zeros(24, 32)
    likelihood[20:, 8:24] = 1  # ahead of the camera
    likelihood[2:5, 2:5] = 1  # far from it

    kept = decide(likelihood, Simple())
    dropped = decide(likelihood, Isolated())

    assert kept[3, 3]
    assert not dropped[3, 3]
    assert torch.equal(dropped[20:], kept[20:])


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("prior:row", {}, r"prior:row: unknown detector \(did you mean .*prior:rows"),
        ("prior:rows", {"treshold": 1.0}, r"treshold: unknown setting \(did you mean threshold"),
        ("prior:rows", {"threshold": 2.0}, r"threshold: 2\.0 was given"),
        ("prior:rows", {"threshold": "high"}, r"threshold: 'high' was given"),
    ],
)
def test_misspelt_names_and_wrong_settings_are_told(
    name: str, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        load_detector(name, **settings)


MANY = Grid("many:<gain>:<kind>", "many of them")


@pytest.fixture
def with_grid(catalogue: dict[str, Entry]) -> None:
    """A detector, a grid of four in two families of names, and one that follows in order."""
    for name in ("bright", "many:2:b", "many:2:a", "many:1:b", "many:1:a", "zebra"):
        register(Entry(name, "", Simple, brightness, MANY if ":" in name else None))


@pytest.mark.usefixtures("with_grid")
def test_a_grid_is_one_group_of_detectors_in_their_own_order() -> None:
    groups = {name: [entry.name for entry in of] for name, of in detector_groups().items()}

    assert list(groups) == ["bright", "many:<gain>:<kind>", "zebra"]
    assert groups["many:<gain>:<kind>"] == ["many:2:b", "many:2:a", "many:1:b", "many:1:a"]
    assert groups["zebra"] == ["zebra"]


@pytest.mark.usefixtures("with_grid")
@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("*", ["bright", "zebra"]),
        ("*a*", ["zebra"]),
        ("many:*", ["many:1:a", "many:1:b", "many:2:a", "many:2:b"]),
        ("many:*:a", ["many:1:a", "many:2:a"]),
        ("many:2:[ab]", ["many:2:a", "many:2:b"]),
    ],
)
def test_wildcards_meet_a_grid_where_they_name_its_family(pattern: str, names: list[str]) -> None:
    assert matching_detectors(pattern) == names


@pytest.mark.usefixtures("with_grid")
def test_a_pattern_that_fits_a_grid_alone_says_how_to_ask_for_it() -> None:
    with pytest.raises(ConfigError, match=r"\*:1:\*: fits only .* many:<gain>:<kind> \(begin it"):
        matching_detectors("*:1:*")
    with pytest.raises(ConfigError, match=r"many:3:\*: unknown detector"):
        matching_detectors("many:3:*")


@pytest.mark.usefixtures("with_grid")
def test_a_name_that_is_near_none_gets_a_short_list() -> None:
    with pytest.raises(ConfigError, match=r"known: bright, many:<gain>:<kind>, zebra"):
        load_detector("0")


FOREIGN = (Entry("theirs", "", Simple, brightness), Entry("theirs:2", "", Simple, brightness))


def offer(monkeypatch: pytest.MonkeyPatch, *attributes: str) -> list[str]:
    """The detectors on offer when another package has these entry points."""
    points = [
        EntryPoint(name, f"tests.test_detectors:{name}", "roadtorch.detectors")
        for name in attributes
    ]
    monkeypatch.setattr(roadtorch.plugins, "entry_points", lambda group: points)
    return sorted(catalogue_module._catalogue.__wrapped__())


def test_other_packages_add_detectors(monkeypatch: pytest.MonkeyPatch) -> None:
    names = offer(monkeypatch, "FOREIGN")

    assert {"theirs", "theirs:2"} <= set(names)


def test_a_broken_package_costs_only_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.warns(RuntimeWarning, match="detectors 'MISSING' .* cannot be used"):
        names = offer(monkeypatch, "MISSING", "FOREIGN")

    assert {"theirs", "prior:rows"} <= set(names)


def test_every_entry_has_a_summary_and_a_threshold() -> None:
    for name in list_detectors():
        entry = detector_entry(name)
        assert entry.summary, name
        assert 0 <= getattr(entry.settings(), "threshold") <= 1, name  # noqa: B009


def test_the_likelihood_is_no_cue() -> None:
    detection = load_detector("cpf").detect(torch.linspace(0, 1, 3 * 32 * 48).reshape(3, 32, 48))

    assert "likelihood" not in detection.cues
    assert len(detection.cues) == len(list(detection.cues)) > 0
    with pytest.raises(KeyError, match="likelihood"):
        detection.cues["likelihood"]
