"""The page in a real browser: headless Chromium, driven by Playwright, over a real server."""

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from roadtorch.annotate.server import make_page_server
from roadtorch.annotate.session import open_session
from roadtorch.data.corrections import Correction, read_corrections
from roadtorch.data.events import layout_layer, road_layer
from roadtorch.detectors.catalogue import load_detector

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium (apt: chromium)")

PATIENCE = 300_000  # milliseconds; a loaded machine is slow


class Server:
    """A folder of images with its page, in a thread of this process."""

    def __init__(self, folder: Path, out: Path) -> None:
        self.folder, self.out = folder, out
        out.mkdir(exist_ok=True)
        session = open_session(folder, out, load_detector("prior:triangle"))
        self._server = make_page_server(session)
        self._thread = threading.Thread(target=self._server.run, daemon=True)
        self._thread.start()
        self.url = self._server.address.url

    def stop(self) -> None:  # twice is once
        self._server.stop()
        self._thread.join(300)

    def corrections(self) -> list[Correction]:
        return read_corrections(self.out, self.folder)


@pytest.fixture
def server(request: pytest.FixtureRequest, streets: Path, tmp_path: Path) -> Iterator[Server]:
    """Run a server on three images, or as many as ``request.param``, the further ones links."""
    for number in range(3, getattr(request, "param", 3)):
        os.link(streets / "street_0.png", streets / f"street_{number}.png")
    running = Server(streets, tmp_path / "corrections")
    yield running
    running.stop()


@pytest.fixture(scope="module")
def browser() -> Iterator["Browser"]:
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


Open = Callable[..., "Page"]


@pytest.fixture
def visit(browser: "Browser") -> Iterator[Open]:
    """Return ``visit(server, width, height)``, which opens a window at the first image."""
    contexts: list[BrowserContext] = []
    mistakes: list[str] = []

    def opened(server: Server, width: int = 1000, height: int = 700) -> "Page":
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.on("pageerror", lambda error: mistakes.append(str(error)))
        page.goto(server.url)
        page.wait_for_selector("body[data-image]")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert mistakes == []


def at_version(page: "Page", version: int) -> None:
    page.wait_for_function(
        "version => document.body.dataset.version === String(version)", arg=version
    )


def wait_for_image(page: "Page", name: str) -> None:
    page.wait_for_function("name => document.body.dataset.image === name", arg=name)


def canvas_point(page: "Page", across: float, down: float) -> tuple[float, float]:
    box = page.locator("#stage").bounding_box()
    assert box is not None
    return box["x"] + across * box["width"], box["y"] + down * box["height"]


def click(page: "Page", across: float, down: float, version: int | None = None) -> None:
    """Click on the image, and wait for its version if one is given."""
    page.mouse.click(*canvas_point(page, across, down))
    if version is not None:
        at_version(page, version)


def press(page: "Page", *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)


def press_and_leave(page: "Page", *keys: str) -> str:
    """Press keys, wait until another image is shown, and return its name."""
    name = page.evaluate("document.body.dataset.image")
    press(page, *keys)
    page.wait_for_function("before => document.body.dataset.image !== before", arg=name)
    return page.evaluate("document.body.dataset.image")


def wait_for_text(page: "Page", identity: str, words: str) -> None:
    """Wait until an element contains a text."""
    page.wait_for_function(
        "([id, words]) => document.getElementById(id).textContent.includes(words)",
        arg=[identity, words],
    )


@pytest.fixture
def page(visit: Open, server: Server) -> "Page":
    return visit(server)


def test_drag_undo_redo_reload(page: "Page", server: Server) -> None:
    press(page, "2")
    page.mouse.move(*canvas_point(page, 0.3, 0.9))
    page.mouse.down()
    page.mouse.move(*canvas_point(page, 0.7, 0.9), steps=12)
    page.mouse.up()
    at_version(page, 1)
    (dragged,) = server.corrections()
    assert 100 < (road_layer(dragged.labels) == 0).sum() < road_layer(dragged.labels).size / 2
    assert not (road_layer(dragged.labels) == 1).any()
    press(page, "z")
    at_version(page, 2)
    assert server.corrections() == []
    press(page, "Control+y")
    at_version(page, 3)
    page.reload()
    at_version(page, 3)
    assert "1 click " in page.locator("#facts").inner_text()
    assert (server.corrections()[0].labels == dragged.labels).all()


@pytest.mark.slow
def test_the_keyboard_alone_is_enough(page: "Page", server: Server) -> None:
    press(page, "?")
    assert page.locator("#help").is_visible()
    assert "Space" in page.locator("#keys").inner_text()
    press(page, "Escape")
    page.wait_for_selector("#help", state="hidden")
    press(page, "ArrowDown", "3", "Space")
    at_version(page, 1)
    press(page, "p")
    for arrow in ("ArrowUp", "ArrowRight", "ArrowDown"):
        press(page, *[arrow] * 12, "Space")
    press(page, "Enter")
    at_version(page, 2)
    press(page, "b", "]", "[", "5", "Space")
    at_version(page, 3)
    press(page, *"+-0oOvvgll", "Control+ArrowLeft")
    following = press_and_leave(page, "n")
    press_and_leave(page, "m", "ArrowDown")
    assert press_and_leave(page, "k") == following
    (corrected,) = server.corrections()
    assert (road_layer(corrected.labels) == 254).any()
    assert (layout_layer(corrected.labels) == 1).any()
    for count in (1, 2):
        press_and_leave(page, "Enter")
        wait_for_text(page, "progress", f"{count} of 3 confirmed")
    press(page, "Enter")
    wait_for_text(
        page, "notice", "All 3 images are confirmed. To train on them: roadtorch train --config"
    )
    assert all(correction.confirmed for correction in server.corrections())


@pytest.mark.slow
@pytest.mark.parametrize("server", [1000], indirect=True)
def test_a_narrow_window_has_a_thousand_images_in_reach(visit: Open, server: Server) -> None:
    page = visit(server, width=360, height=640)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert not page.locator("#side").is_visible()
    page.locator("#hint-seen").click()
    page.locator("button", has_text="not road").click()
    click(page, 0.5, 0.55, version=1)
    page.locator("#show-list").click()
    page.evaluate("document.getElementById('list').scrollTop = 1e6")
    page.locator(".row", has_text="street_999.png").click()
    wait_for_image(page, "street_999.png")
    requests = page.evaluate("performance.getEntriesByType('resource').map((entry) => entry.name)")
    assert 0 < sum("/api/thumbnail" in request for request in requests) < 150
    assert not page.locator("#side").is_visible()
    assert not page.locator("#hint").is_visible()
    assert (road_layer(server.corrections()[0].labels) == 0).any()


@pytest.mark.slow
def test_two_windows_lose_nothing(visit: Open, page: "Page", server: Server) -> None:
    second = visit(server)
    click(page, 0.5, 0.9, version=1)
    at_version(second, 1)  # it comes by itself
    press(second, "2")
    click(second, 0.5, 0.2, version=2)
    at_version(page, 2)
    (corrected,) = server.corrections()
    assert (road_layer(corrected.labels) == 1).any()
    assert (road_layer(corrected.labels) == 0).any()


@pytest.mark.slow
def test_strokes_wait_through_a_reload_and_a_restart(page: "Page", server: Server) -> None:
    page.route("**/api/event*", lambda route: route.abort())
    click(page, 0.5, 0.9)
    wait_for_text(page, "notice", "1 unsent event")
    page.unroute("**/api/event*")
    page.reload()
    at_version(page, 1)
    server.stop()
    press(page, "2")
    click(page, 0.5, 0.2)
    wait_for_text(page, "notice", "1 unsent event")
    click(page, 0.2, 0.2)
    restarted = Server(server.folder, server.out)
    assert restarted.url == server.url
    at_version(page, 3)
    page.wait_for_selector("#notice", state="hidden")
    (corrected,) = restarted.corrections()
    assert (road_layer(corrected.labels) == 1).any()
    assert (road_layer(corrected.labels) == 0).any()
    restarted.stop()
