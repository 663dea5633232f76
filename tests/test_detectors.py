"""Contract of every registered detector, on any device, and the catalogue."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import roadtorch.base.plugins
from roadtorch.base.compute import one_torch_thread
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.settings import Settings
from roadtorch.detectors import catalogue as catalogue_module
from roadtorch.detectors.catalogue import (
    detector_entry,
    detector_groups,
    list_detectors,
    load_detector,
    register_detector,
)
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.entry import DetectorGrid, DetectorSettings, Entry, WorkingSettings
from roadtorch.road.seed_area import SeedArea
from roadtorch.testing import contract_violations, street
from roadtorch.testing.scenes import render_scene
from scripts import freeze
from tests.pretended_device import Pretended, PretendedDevice, move_to_pretended
from tests.representatives import distinct_detectors, quick, representatives

# --- the contract -------------------------------------------------------------------------


@pytest.mark.parametrize("name", representatives())
def test_every_detector_keeps_to_the_contract(name: str) -> None:
    assert contract_violations(detector_entry(name), **quick(name)) == []
    everything = load_detector(name, threshold=0.0, **quick(name)).detect(street(48, 64))
    assert everything.mask.all()


def with_value(value: float) -> Tensor:
    image = street(32, 32)
    image[1, 5, 7] = value
    return image


@pytest.mark.parametrize(
    ("image", "problem"),
    [
        (with_value(float("nan")), "holds NaN"),
        (with_value(1.5), "has values from 0"),
        (street(32, 32)[:1], "has the shape (1, 32, 32)"),
        (street(32, 32)[None], "has the shape (1, 3, 32, 32)"),
        (street(15, 15), "is 15×15 pixels"),
        (torch.zeros(3, 32, 32, dtype=torch.int32), "is torch.int32"),
        ([[0.5]], "is a list, not one image"),
    ],
    ids="nan bright grey batch small int list".split(),  # noqa: SIM905
)
def test_what_is_no_image_is_refused_with_the_reason(image: Any, problem: str) -> None:
    with pytest.raises(InputError) as caught:
        load_detector("prior:rows").detect(image)

    assert caught.value.where == "image"
    assert caught.value.problem.startswith(problem)


# --- the door -----------------------------------------------------------------------------


class Simple(DetectorSettings):
    gain: float = 1.0


class Brightness(nn.Module):
    """Mean of the channels."""

    def __init__(self, settings: Simple) -> None:
        super().__init__()
        self.gain = settings.gain

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        return {"likelihood": image.mean(0) * self.gain, "red": image[0]}


MANY = DetectorGrid("many:<gain>:<kind>", "many of them")


@pytest.fixture
def catalogue(monkeypatch: pytest.MonkeyPatch) -> dict[str, Entry]:
    """Replace the catalogue by an empty one."""
    entries: dict[str, Entry] = {}
    monkeypatch.setattr(catalogue_module, "_catalogue", lambda: entries)
    return entries


@pytest.fixture
def with_grid(catalogue: dict[str, Entry]) -> None:
    """Register a detector, a grid of four, and a detector that follows in order."""
    for name in ("bright", "many:2:b", "many:2:a", "many:1:b", "many:1:a", "zebra"):
        grid = MANY if ":" in name else None
        catalogue[name] = Entry(name, "", Simple, Brightness, grid)


@pytest.mark.usefixtures("catalogue")
def test_a_registered_detector_is_found_set_and_run() -> None:
    defaults = {"gain": 3.0, "seed_area": {"width": 40}}
    assert register_detector("bright", Simple, defaults=defaults)(Brightness) is Brightness

    detection = load_detector("bright", gain=2).detect(torch.full((3, 16, 16), 0.4))
    settings = load_detector("bright", seed_area={"height": 20}).settings

    assert list_detectors() == ["bright"]
    assert detector_entry("bright").summary == "Mean of the channels"
    assert torch.equal(detection.likelihood, torch.full((16, 16), 0.8))
    assert detection.mask.all()
    assert list(detection.cues) == ["red"]
    # Its own defaults are below what is given.
    assert settings == Simple(gain=3.0, seed_area=SeedArea(height=20, width=40))


class Silent(nn.Module):
    def __init__(self, answer: Any) -> None:
        super().__init__()
        self.answer = answer

    def forward(self, image: Tensor) -> Any:
        return self.answer


def registered(name: str, kind: Any, build: Callable[[Any], Any]) -> None:
    register_detector(name, kind)(build)
    load_detector(name).detect(torch.rand(3, 16, 16))


misused: Any = catalogue_module  # calls that a type checker refuses


@pytest.mark.usefixtures("with_grid")
@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda: registered("bright", Simple, Brightness), "bright: is already the name of a d"),
        (lambda: registered("other", Settings, Brightness), "other: has settings .Settings. that"),
        (lambda: registered("other", Simple, lambda _: street), "other: builds function .build an"),
        (lambda: registered("other", Simple, lambda _: Silent(1)), "other: returns no likelihood "),
        (
            lambda: registered(
                "other", Simple, lambda _: Silent({"likelihood": torch.ones(3, 9, 9)})
            ),
            r"other: returns a likelihood of the shape \(3, 9, 9\)",
        ),
        (
            lambda: registered(
                "other", Simple, lambda _: Silent({"likelihood": 3 * torch.eye(16)})
            ),
            "other: returns likelihoods from 0 to 3",
        ),
        (lambda: misused.register_detector(Brightness), "name: is Brightness .write @register_d"),
        (lambda: load_detector("many:<gain>:<kind>"), "is a grid of many detectors .name one; 'm"),
        (lambda: list_detectors("*:1:*"), r"\*:1:\*: matches only .* many:<gain>:<kind> \(be"),
        (lambda: load_detector("0"), "known: bright, many:<gain>:<kind>, zebra"),
        (lambda: misused.load_detector({"gain": 2}, "bright"), "settings: got str by position"),
        (lambda: misused.load_detector("bright", {"gain": 2}), "settings: got dict by position"),
        (lambda: misused.load_detector({"gain": 2}), "name: got dict by position .write load_det"),
    ],
)
def test_what_is_no_detector_is_refused(call: Callable[[], object], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        call()


@pytest.mark.usefixtures("with_grid")
def test_a_likelihood_out_of_range_by_rounding_is_clamped() -> None:
    register_detector("other", Simple)(lambda _: Silent({"likelihood": 1.000005 * torch.eye(16)}))

    detection = load_detector("other").detect(torch.rand(3, 16, 16))

    assert torch.equal(detection.likelihood, torch.eye(16))


@pytest.mark.usefixtures("with_grid")
def test_lists_have_what_there_is_to_compare_a_grid_once_in_its_own_order() -> None:
    groups = {name: [entry.name for entry in of] for name, of in detector_groups().items()}

    assert list_detectors() == list(groups) == ["bright", "many:<gain>:<kind>", "zebra"]
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
    assert list_detectors(pattern) == names


# --- other packages -----------------------------------------------------------------------

FOREIGN = (Entry("theirs", "", Simple, Brightness), Entry("theirs:2", "", Simple, Brightness))


class Point:
    """An entry point that does something else than to load."""

    name, dist, value = "deadly", None, "deadly:ENTRY"

    def __init__(self, load: Callable[[], object]) -> None:
        self.load = load


def offered(monkeypatch: pytest.MonkeyPatch, *points: Any) -> list[str]:
    """List the detectors when other packages have these entry points."""
    monkeypatch.setattr(roadtorch.base.plugins, "entry_points", lambda group: points)
    return sorted(catalogue_module._catalogue.__wrapped__())


@pytest.mark.parametrize(
    "kind", [ImportError, SystemExit, KeyboardInterrupt, GeneratorExit, RecursionError]
)
def test_a_broken_package_costs_only_its_own_even_if_it_ends_the_process(
    kind: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    def load() -> object:
        raise kind

    foreign = EntryPoint("FOREIGN", "tests.test_detectors:FOREIGN", "roadtorch.detectors")
    with pytest.warns(RuntimeWarning, match="'deadly' of deadly:ENTRY cannot be used"):
        names = offered(monkeypatch, Point(load), foreign)

    assert {"theirs", "theirs:2", "prior:rows"} <= set(names)


@pytest.mark.parametrize("raised", [KeyboardInterrupt, ImportError, None])
def test_a_ctrl_c_while_a_package_is_imported_is_not_the_packages_own(
    raised: type[BaseException] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load() -> object:
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:  # some packages catch everything
            if raised is not None:
                raise raised from None
        return FOREIGN

    with pytest.raises(KeyboardInterrupt):
        offered(monkeypatch, Point(load))


# --- a likelihood that is none ------------------------------------------------------------


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("settings", [DetectorSettings, WorkingSettings])
def test_likelihoods_not_finite_are_refused(value: float, settings: type[DetectorSettings]) -> None:
    broken = Silent({"likelihood": with_value(value)[1]})  # the same of every pixel, but for one
    detector = Detector(Entry("theirs", "", settings, lambda _: broken), settings())

    with pytest.raises(InputError, match="gives theirs a likelihood that is not finite"):
        detector.detect(street(32, 32))
    with pytest.raises(InputError, match="not finite"):
        detector.forward(street(32, 32)[None])


# --- one image is one thread's work -----------------------------------------------------


@pytest.fixture
def two_threads() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(threads)


def threads_of_a_new_one() -> int:
    with ThreadPoolExecutor(1) as new:
        return new.submit(torch.get_num_threads).result()


@pytest.mark.parametrize("name", ["fusion", "fusion:paper", "ufl", "oneclass:gaussian:HS"])
def test_a_default_device_of_the_user_changes_nothing(name: str) -> None:
    image = street(48, 64)
    expected = load_detector(name).detect(image).likelihood

    with torch.device("meta"):  # as of torch.set_default_device
        likelihood = load_detector(name).detect(image).likelihood

    assert torch.equal(likelihood, expected)


@pytest.mark.usefixtures("two_threads")
def test_in_several_threads_the_bytes_are_the_same() -> None:
    detector, image = load_detector("fusion"), street(240, 320)
    with one_torch_thread():
        alone = detector.detect(image)

    with ThreadPoolExecutor(3) as pool:
        parallel = [detector.detect(image), *pool.map(detector.detect, [image] * 3)]
        kept = set(pool.map(lambda _: torch.get_num_threads(), range(9)))

    for detection in parallel:
        assert torch.equal(detection.likelihood, alone.likelihood)
        assert torch.equal(detection.cues["layout"], alone.cues["layout"])
    assert kept == {2}
    assert threads_of_a_new_one() == torch.get_num_threads() == 2


@pytest.mark.usefixtures("two_threads")
def test_inside_the_block_this_thread_alone_has_one_whatever_goes_wrong() -> None:
    @one_torch_thread()
    def fails() -> None:
        counts.append((torch.get_num_threads(), threads_of_a_new_one()))
        raise ValueError("inside")

    counts: list[tuple[int, int]] = []
    with pytest.raises(ValueError, match="inside"):
        one_torch_thread()(fails)()

    assert counts == [(1, 2)]
    assert (torch.get_num_threads(), threads_of_a_new_one()) == (2, 2)


# --- on another device ------------------------------------------------------------------


IMAGE = render_scene(5, 48, 64).image


@pytest.mark.parametrize("name", distinct_detectors())
def test_a_detector_works_on_another_device(name: str) -> None:
    result = load_detector(name, **quick(name)).detect(IMAGE)
    detector = move_to_pretended(load_detector(name, **quick(name)))

    with PretendedDevice():
        on_device = detector.detect(Pretended(IMAGE))  # type: ignore[attr-defined]

    assert isinstance(on_device.likelihood, Pretended)
    assert isinstance(on_device.mask, Pretended)
    # On the CPU it is OpenCV that resizes: equal but for rounding, which deep networks magnify.
    rounding = 5e-5 if name.startswith("fusion") else 1e-6
    np.testing.assert_allclose(on_device.likelihood.plain, result.likelihood, atol=rounding, rtol=0)
    assert torch.equal(on_device.mask.plain, result.mask)
    assert on_device.trust == (
        None if result.trust is None else pytest.approx(result.trust, abs=1e-4)
    )
    assert on_device.doubt == result.doubt
    assert set(on_device.cues) == set(result.cues)


def test_images_are_moved_to_the_device_that_a_detector_was_made_for() -> None:
    detector = move_to_pretended(load_detector("fusion"))
    detector.device = "meta"  # type: ignore[assignment]

    with PretendedDevice():
        on_device = detector([IMAGE.numpy().transpose(1, 2, 0)], order="rgb")[0]  # type: ignore[operator]

    assert isinstance(on_device.likelihood, Pretended)


# --- memory -----------------------------------------------------------------------------


DETECT = """
import json, resource, torch
from roadtorch import load_detector
from roadtorch.testing.scenes import render_scene
detector, small, peaks = load_detector("fusion"), render_scene(0, 240, 320).image, []
for height in (480, 1200):
    width = height * 4 // 3
    rows, columns = torch.arange(height) * 240 // height, torch.arange(width) * 320 // width
    image = torch.empty(3, height, width)
    for plane, values in zip(image, small):
        for row, place in zip(plane, rows):
            row.copy_(values[place][columns])
    detector.detect(image)
    peaks.append((height * width, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024))
print(json.dumps(peaks))
"""


def test_the_memory_of_a_large_image_stays_below_24_bytes_a_pixel() -> None:
    """Of the image itself 12, of likelihood and mask 5: the rest is made on the way."""
    (few, small), (many, large) = json.loads(
        subprocess.check_output([sys.executable, "-c", DETECT])
    )

    assert (large - small) / (many - few) < 24


# --- what they said before --------------------------------------------------------------


FROZEN = json.loads((Path(__file__).parent / "frozen.json").read_text(encoding="utf-8"))
AWAY = 4.0  # 255ths: how far another machine's arithmetic may move a likelihood, on average


def test_every_detector_says_what_it_said() -> None:
    """Meant to change? `python scripts/freeze.py thumbnails tests/frozen.json` writes it anew."""
    # Other tests of this process may have put detectors of theirs into the catalogue.
    names = [name for name in freeze.detectors() if not name.startswith("test-")]

    current = freeze.thumbnails(names)

    assert list(current) == list(FROZEN)
    frozen, new = (np.array(list(maps.values())) for maps in (FROZEN, current))
    assert new.shape == (len(FROZEN), 2, 6 * 8)
    away = abs(new - frozen).mean((1, 2))
    assert [name for name, share in zip(FROZEN, away, strict=True) if share > AWAY] == []
