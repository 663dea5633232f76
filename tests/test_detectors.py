"""What every registered detector keeps to, and the door that leads to them."""

import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor, nn

import roadtorch.runtime.plugins
from roadtorch.detector import (
    Detection,
    Detector,
    DetectorGrid,
    DetectorSettings,
    Entry,
    WorkingSettings,
    checked_image,
)
from roadtorch.detectors import catalogue as catalogue_module
from roadtorch.detectors.catalogue import (
    detector_entry,
    detector_groups,
    list_detectors,
    load_detector,
    register,
)
from roadtorch.detectors.fusion import Fusion
from roadtorch.errors import ConfigError, InputError
from roadtorch.io.image import overlay_pixels
from roadtorch.road.seed_area import SeedArea
from roadtorch.runtime.threads import one_thread
from roadtorch.settings import Settings
from roadtorch.testing import broken_promises, street
from tests.representatives import quick, representatives

NAMES = representatives()


@cache
def loaded(name: str) -> Detector:
    """Loaded once: the tests are about what detectors say, not about loading."""
    return load_detector(name)


# --- the contract -------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_every_detector_keeps_to_the_contract(name: str) -> None:
    assert broken_promises(detector_entry(name), **quick(name)) == []


@pytest.mark.parametrize("name", NAMES)
def test_at_threshold_zero_everything_is_road(name: str) -> None:
    detector = load_detector(name, threshold=0.0, **quick(name))

    assert detector.detect(street(96, 128)).mask.all()


def with_value(value: float) -> Tensor:
    image = street(32, 32)
    image[1, 5, 7] = value
    return image


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
        (torch.zeros(3, 32, 32, dtype=torch.int32), "is torch.int32"),
        ([[0.5]], "is a list, not one picture"),
        (torch.zeros(3, 32, 32).to_sparse(), "has the layout torch.sparse_coo"),
    ],
    ids="nan inf bright negative grey batch small none int list sparse".split(),  # noqa: SIM905
)
def test_what_is_no_image_is_refused_with_the_reason(image: Any, what: str) -> None:
    with pytest.raises(InputError) as caught:
        loaded("prior:rows").detect(image)

    assert caught.value.where == "image"
    assert caught.value.what.startswith(what)


def test_a_batch_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match=r"images: have the shape \(3, 32, 32\)"):
        load_detector("prior:rows").forward(street(32, 32))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_floating_types_become_float32(dtype: torch.dtype) -> None:
    assert checked_image(street(16, 16).to(dtype)).dtype == torch.float32


# --- the door -----------------------------------------------------------------------------


class Simple(DetectorSettings):
    gain: float = 1.0


class Brightness(nn.Module):
    def __init__(self, settings: Simple) -> None:
        super().__init__()
        self.gain = settings.gain

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        return {"likelihood": image.mean(0) * self.gain, "red": image[0]}


@pytest.fixture
def catalogue(monkeypatch: pytest.MonkeyPatch) -> dict[str, Entry]:
    """The catalogue of this test alone."""
    entries: dict[str, Entry] = {}
    monkeypatch.setattr(catalogue_module, "_catalogue", lambda: entries)
    return entries


def test_a_registered_detector_is_found_set_and_run(catalogue: dict[str, Entry]) -> None:
    register(Entry("bright", "mean of the channels", Simple, Brightness))
    image = torch.full((3, 16, 16), 0.4)

    detection = load_detector("bright", gain=2).detect(image)

    assert list_detectors() == ["bright"]
    assert torch.equal(detection.likelihood, torch.full((16, 16), 0.8))
    assert detection.mask.all()
    assert list(detection.cues) == ["red"]


def test_a_name_is_given_once(catalogue: dict[str, Entry]) -> None:
    entry = Entry("bright", "", Simple, Brightness)
    register(entry)

    with pytest.raises(ConfigError, match="bright: is the name of another detector"):
        register(entry)


def test_an_entry_has_defaults_of_its_own_below_what_is_given(catalogue: dict[str, Entry]) -> None:
    values = {"gain": 3.0, "seed_area": {"width": 40}}
    register(Entry("bright", "", Simple, Brightness, values=values))

    settings = load_detector("bright", seed_area={"height": 20}).settings

    assert settings == Simple(gain=3.0, seed_area=SeedArea(height=20, width=40))


def test_settings_of_another_kind_are_refused(catalogue: dict[str, Entry]) -> None:
    with pytest.raises(ConfigError, match=r"bright: has settings \(Settings\) that are no D"):
        register(Entry("bright", "", Settings, Brightness))  # pyright: ignore[reportArgumentType]


def test_what_is_built_must_be_a_module(catalogue: dict[str, Entry]) -> None:
    def build(settings: Simple) -> Any:
        return lambda image: {"likelihood": image.mean(0)}

    register(Entry("bright", "", Simple, build))

    with pytest.raises(ConfigError, match=r"bright: builds function \(build an nn\.Module"):
        load_detector("bright")


@pytest.mark.parametrize("given", [torch.ones(16, 16), {"road": torch.ones(16, 16)}])
def test_an_analysis_without_likelihood_is_named(catalogue: dict[str, Entry], given: Any) -> None:
    class Silent(nn.Module):
        def forward(self, image: Tensor) -> Any:
            return given

    register(Entry("silent", "", Simple, lambda settings: Silent()))

    with pytest.raises(ConfigError, match=r"silent: gives no likelihood: Silent\.forward has to"):
        load_detector("silent").detect(torch.rand(3, 16, 16))


def test_the_parts_of_a_detector_can_be_seen_and_their_weights_are_its_own() -> None:
    detector = load_detector("fusion")

    assert isinstance(detector.analysis, Fusion)
    assert detector.analysis.network.settings.width == 160
    assert all(name.startswith("analysis.network.") for name in detector.state_dict())


MANY = DetectorGrid("many:<gain>:<kind>", "many of them")


@pytest.fixture
def with_grid(catalogue: dict[str, Entry]) -> None:
    """A detector, a grid of four in two families of names, and one that follows in order."""
    for name in ("bright", "many:2:b", "many:2:a", "many:1:b", "many:1:a", "zebra"):
        register(Entry(name, "", Simple, Brightness, MANY if ":" in name else None))


@pytest.mark.usefixtures("with_grid")
def test_lists_have_what_there_is_to_compare_a_grid_once() -> None:
    assert list_detectors() == ["bright", "many:<gain>:<kind>", "zebra"]
    with pytest.raises(ConfigError, match=r"stands for many detectors \(name one; 'many:\*' lists"):
        load_detector("many:<gain>:<kind>")


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
    assert list_detectors(pattern) == names


@pytest.mark.usefixtures("with_grid")
def test_a_pattern_that_fits_a_grid_alone_says_how_to_ask_for_it() -> None:
    with pytest.raises(ConfigError, match=r"\*:1:\*: fits only .* many:<gain>:<kind> \(begin it"):
        list_detectors("*:1:*")
    with pytest.raises(ConfigError, match=r"many:3:\*: unknown detector"):
        list_detectors("many:3:*")


@pytest.mark.usefixtures("with_grid")
def test_a_name_that_is_near_none_gets_a_short_list() -> None:
    with pytest.raises(ConfigError, match=r"known: bright, many:<gain>:<kind>, zebra"):
        load_detector("0")


FOREIGN = (Entry("theirs", "", Simple, Brightness), Entry("theirs:2", "", Simple, Brightness))


def offer(monkeypatch: pytest.MonkeyPatch, *attributes: str) -> list[str]:
    """The detectors on offer when another package has these entry points."""
    points = [
        EntryPoint(name, f"tests.test_detectors:{name}", "roadtorch.detectors")
        for name in attributes
    ]
    monkeypatch.setattr(roadtorch.runtime.plugins, "entry_points", lambda group: points)
    return sorted(catalogue_module._catalogue.__wrapped__())


def test_a_broken_package_costs_only_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.warns(RuntimeWarning, match="detectors 'MISSING' .* cannot be used"):
        names = offer(monkeypatch, "MISSING", "FOREIGN")

    assert {"theirs", "theirs:2", "prior:rows"} <= set(names)


@pytest.mark.parametrize("kind", [SystemExit, KeyboardInterrupt, GeneratorExit, RecursionError])
def test_a_package_that_ends_the_process_costs_only_its_own(
    kind: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Point:
        name, dist, value = "deadly", None, "deadly:ENTRY"

        def load(self) -> None:
            raise kind

    monkeypatch.setattr(roadtorch.runtime.plugins, "entry_points", lambda group: [Point()])

    with pytest.warns(RuntimeWarning, match="'deadly' of deadly:ENTRY cannot be used"):
        names = catalogue_module._catalogue.__wrapped__()

    assert "fusion" in names


@pytest.mark.parametrize("own", [KeyboardInterrupt, ImportError, None])
def test_a_ctrl_c_while_a_package_is_imported_is_not_the_packages_own(
    own: type[BaseException] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Point:
        name, dist, value = "slow", None, "slow:ENTRY"

        def load(self) -> object:
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except KeyboardInterrupt:  # some packages catch everything
                if own is not None:
                    raise own from None
            return FOREIGN

    monkeypatch.setattr(roadtorch.runtime.plugins, "entry_points", lambda group: [Point()])

    with pytest.raises(KeyboardInterrupt):
        catalogue_module._catalogue.__wrapped__()


def test_every_entry_has_a_summary_and_the_priors_alone_are_baselines() -> None:
    entries = [entry for group in detector_groups().values() for entry in group]

    assert all(entry.summary for entry in entries)
    baselines = {entry.name for entry in entries if entry.baseline}
    assert baselines == {"prior:rows", "prior:triangle", "prior:uniform"}


# --- a likelihood that is none ------------------------------------------------------------


class Broken(nn.Module):
    """A detector that says the same of every pixel, but for one."""

    def __init__(self, value: float) -> None:
        super().__init__()
        self.value = value

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        likelihood = image.mean(0)
        likelihood[3, 4] = self.value
        return {"likelihood": likelihood}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("settings", [DetectorSettings, WorkingSettings])
def test_a_likelihood_that_is_not_finite_is_refused(
    value: float, settings: type[DetectorSettings]
) -> None:
    detector = Detector(Entry("theirs", "", settings, lambda _: Broken(value)), settings())

    with pytest.raises(InputError, match="gives theirs a likelihood that is not finite"):
        detector.detect(street(32, 32))
    with pytest.raises(InputError, match="not finite"):
        detector(street(32, 32)[None])


# --- one picture is one thread's work -----------------------------------------------------


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def threads_of_a_new_one() -> int:
    with ThreadPoolExecutor(1) as new:
        return new.submit(torch.get_num_threads).result()


@pytest.mark.usefixtures("two_threads")
def test_beside_busy_processes_and_in_several_threads_the_bytes_are_the_same() -> None:
    detector, image = loaded("fusion"), street(240, 320)
    with one_thread():
        alone = detector.detect(image)
    spin = [sys.executable, "-c", "while True: pass"]

    with subprocess.Popen(spin) as one, subprocess.Popen(spin) as two:
        with ThreadPoolExecutor(3) as pool:
            beside = [detector.detect(image), *pool.map(detector.detect, [image] * 3)]
            kept = set(pool.map(lambda _: torch.get_num_threads(), range(9)))
        one.kill()
        two.kill()

    for detection in beside:
        assert torch.equal(detection.likelihood, alone.likelihood)
        assert torch.equal(detection.cues["layout"], alone.cues["layout"])
    assert kept == {2}
    assert threads_of_a_new_one() == torch.get_num_threads() == 2


@pytest.mark.usefixtures("two_threads")
def test_inside_the_block_this_thread_alone_has_one_whatever_goes_wrong() -> None:
    @one_thread()
    def fails() -> None:
        seen.append((torch.get_num_threads(), threads_of_a_new_one()))
        raise ValueError("inside")

    seen: list[tuple[int, int]] = []
    with pytest.raises(ValueError, match="inside"):
        one_thread()(fails)()

    assert seen == [(1, 2)]
    assert (torch.get_num_threads(), threads_of_a_new_one()) == (2, 2)


# --- what is taken, and what a detection shows --------------------------------------------


def test_an_overlay_is_what_infer_draws(tmp_path: Path) -> None:
    detection = loaded("fusion").detect(street(96, 128))
    assert detection.image is not None
    ego, caption = detection.cues["ego"], f"trust {detection.trust:.2f}"

    drawn = detection.overlay()

    assert (drawn.dtype, drawn.shape) == (np.uint8, (96, 128, 3))
    assert np.array_equal(drawn, overlay_pixels(detection.image, detection.mask, ego, caption))


def test_a_detection_without_its_image_has_no_overlay() -> None:
    detection = Detection(torch.zeros(16, 16), torch.zeros(16, 16).bool(), {})

    assert detection._repr_png_() is None
    with pytest.raises(InputError, match="is not part of this detection"):
        detection.overlay()


def test_notebooks_show_a_line_and_the_overlay() -> None:
    detection = loaded("prior:rows").detect(street(40, 2000))
    shown = detection._repr_png_()

    assert re.fullmatch(r"<Detection 2000×40, road \d+%>", repr(detection))
    assert shown is not None
    assert Image.open(io.BytesIO(shown)).size == (960, 19)
    doubtful = replace(detection, trust=0.314, doubt="no road found")
    assert repr(doubtful).endswith(", trust 0.31 (no road found)>")
