"""The page in a real browser: headless Chromium, driven by Playwright, over a real server."""

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from roadtorch.annotate.server import page_server
from roadtorch.annotate.session import opened_session
from roadtorch.data.corrections import Correction, read_corrections
from roadtorch.detectors.catalogue import load_detector

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium (apt: chromium)")

PATIENCE = 60_000  # milliseconds; a loaded machine is slow


class Server:
    """A folder of pictures with its page, in a thread of this process."""

    def __init__(self, folder: Path, out: Path) -> None:
        self.folder, self.out = folder, out
        out.mkdir(exist_ok=True)
        session = opened_session(folder, out, load_detector("prior:triangle"))
        self._server = page_server(session)
        self._thread = threading.Thread(target=self._server.run, daemon=True)
        self._thread.start()
        self.url = self._server.address.url

    def stop(self) -> None:  # twice is once
        self._server.stop()
        self._thread.join(30)

    def corrections(self) -> list[Correction]:
        return read_corrections(self.out, self.folder)


@pytest.fixture
def server(request: pytest.FixtureRequest, streets: Path, tmp_path: Path) -> Iterator[Server]:
    """Three pictures, or so many, the further ones all the same."""
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
    """``visit(server, user, width, height)``: a window of its own, at the first picture."""
    contexts: list[BrowserContext] = []
    mistakes: list[str] = []

    def opened(server: Server, user: str = "ann", width: int = 1000, height: int = 700) -> "Page":
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.on("pageerror", lambda error: mistakes.append(str(error)))
        page.goto(server.url)
        page.fill("#user", user)
        press(page, "Enter")
        page.wait_for_selector("body[data-picture]")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert mistakes == []


def at_version(page: "Page", version: int) -> None:
    page.wait_for_function(
        "version => document.body.dataset.version === String(version)", arg=version
    )


def shown(page: "Page", name: str) -> None:
    page.wait_for_function("name => document.body.dataset.picture === name", arg=name)


def place_of(page: "Page", across: float, down: float) -> tuple[float, float]:
    box = page.locator("#stage").bounding_box()
    assert box is not None
    return box["x"] + across * box["width"], box["y"] + down * box["height"]


def click(page: "Page", across: float, down: float, version: int | None = None) -> None:
    """Click on the picture, and wait for its version if one is given."""
    page.mouse.click(*place_of(page, across, down))
    if version is not None:
        at_version(page, version)


def press(page: "Page", *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)


def tells(page: "Page", identity: str, words: str) -> None:
    """Wait until an element says these words."""
    page.wait_for_function(
        "([id, words]) => document.getElementById(id).textContent.includes(words)",
        arg=[identity, words],
    )


# --- correcting -------------------------------------------------------------------------


def test_correct_undo_redo_reload(visit: Open, server: Server) -> None:
    page = visit(server)
    press(page, "2")
    click(page, 0.5, 0.9, version=1)
    (one,) = server.corrections()
    assert 0 < (one.road == 0).sum() < one.road.size / 4
    assert not (one.road == 1).any()
    press(page, "z")
    at_version(page, 2)
    assert server.corrections() == []
    press(page, "Control+y")
    at_version(page, 3)
    page.reload()
    at_version(page, 3)
    assert "1 click " in page.locator("#facts").inner_text()
    assert (server.corrections()[0].labels == one.labels).all()


@pytest.mark.slow
def test_drag_polygon_and_brush(visit: Open, server: Server) -> None:
    page = visit(server)
    page.mouse.move(*place_of(page, 0.3, 0.9))
    page.mouse.down()
    page.mouse.move(*place_of(page, 0.7, 0.9), steps=12)
    page.mouse.up()
    at_version(page, 1)
    press(page, "p", "4")
    for place in ((0.3, 0.1), (0.7, 0.1), (0.7, 0.3)):
        click(page, *place)
    press(page, "Enter")
    at_version(page, 2)
    press(page, "b", "5")
    click(page, 0.5, 0.5, version=3)
    (one,) = server.corrections()
    assert (one.road == 1).sum() > 100
    assert {0, 1, 2} <= set(one.layout.reshape(-1).tolist())


@pytest.mark.slow
def test_right_as_it_is_in_one_key_and_the_next_comes(visit: Open, server: Server) -> None:
    page = visit(server)
    shown(page, "street_0.png")
    press(page, "Enter")
    shown(page, "street_1.png")
    (one,) = server.corrections()
    assert (one.name, one.confirmed, one.clicks) == ("street_0.png", True, 1)
    tells(page, "progress", "1 of 3 right")


@pytest.mark.slow
def test_the_keyboard_alone_is_enough(visit: Open, server: Server) -> None:
    page = visit(server, "keys")
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
    press(page, *"+-0oOvvgll", "Control+ArrowLeft", "]", "[")
    press(page, "n")
    shown(page, "street_1.png")
    press(page, "k")
    shown(page, "street_0.png")
    press(page, "m", "ArrowDown")
    shown(page, "street_1.png")
    (one,) = server.corrections()
    assert one.users == ("keys",)
    assert (one.road == 254).any()


@pytest.mark.slow
def test_a_narrow_window_has_everything_in_reach(visit: Open, server: Server) -> None:
    page = visit(server, width=360, height=640)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert not page.locator("#side").is_visible()
    page.locator("button", has_text="not road").click()
    click(page, 0.5, 0.55, version=1)
    page.locator("#show-list").click()
    page.locator(".row", has_text="street_2").click()
    shown(page, "street_2.png")
    assert not page.locator("#side").is_visible()
    assert (server.corrections()[0].road == 0).any()


@pytest.mark.slow
def test_the_hint_goes_for_good_and_the_colour_stays(visit: Open, server: Server) -> None:
    page = visit(server)
    road = "() => getComputedStyle(document.documentElement).getPropertyValue('--road')"
    assert page.locator("#hint li").count() == 3
    assert page.evaluate(road) == "rgb(86 180 233)"  # as infer draws it
    page.locator("#hint-seen").click()
    press(page, "h")
    assert page.evaluate(road) == "rgb(0 158 115)"
    page.reload()
    page.wait_for_selector("body[data-picture]")
    assert not page.locator("#hint").is_visible()
    assert page.evaluate(road) == "rgb(0 158 115)"


@pytest.mark.slow
def test_the_last_that_is_right_says_what_learns_from_them(visit: Open, server: Server) -> None:
    page = visit(server)
    names = ("street_0.png", "street_1.png", "street_2.png")
    for count, name in enumerate(names, 1):
        shown(page, name)
        press(page, "Enter")
        tells(page, "progress", f"{count} of 3 right")

    tells(page, "notice", "All done: 3 of 3 right. To learn from them: roadtorch train --config")


# --- several windows and people ---------------------------------------------------------


@pytest.mark.slow
def test_two_windows_of_one_person_lose_nothing(visit: Open, server: Server) -> None:
    one, other = visit(server, "ann"), visit(server, "ann")
    click(one, 0.5, 0.9, version=1)
    at_version(other, 1)  # it comes by itself
    press(other, "2")
    click(other, 0.5, 0.2, version=2)
    at_version(one, 2)
    (found,) = server.corrections()
    assert (found.road == 1).any()
    assert (found.road == 0).any()


@pytest.mark.slow
def test_two_people_see_how_far_they_agree(visit: Open, server: Server) -> None:
    ann, bob = visit(server, "ann"), visit(server, "bob")
    click(ann, 0.5, 0.9, version=1)
    click(bob, 0.5, 0.9, version=1)
    assert "agreement 100.0 %" in bob.locator("#facts").inner_text()
    assert server.corrections()[0].users == ("ann", "bob")
    bob.wait_for_function(
        "() => document.querySelector('.row small').textContent.includes('ann 1, bob 1')"
    )


# --- what goes wrong --------------------------------------------------------------------


@pytest.mark.slow
def test_a_server_that_is_started_again_gets_what_waits(visit: Open, server: Server) -> None:
    page = visit(server)
    click(page, 0.5, 0.9, version=1)
    server.stop()
    press(page, "2")
    click(page, 0.5, 0.2)
    tells(page, "notice", "1 event waits here")
    click(page, 0.2, 0.2)
    again = Server(server.folder, server.out)
    assert again.url == server.url
    at_version(page, 3)
    page.wait_for_selector("#notice", state="hidden")
    (one,) = again.corrections()
    assert (one.road == 1).any()
    assert (one.road == 0).any()
    again.stop()


@pytest.mark.slow
def test_what_waits_outlives_a_reload(visit: Open, server: Server) -> None:
    page = visit(server)
    page.route("**/api/event*", lambda route: route.abort())
    click(page, 0.5, 0.9)
    tells(page, "notice", "1 event waits here")
    page.unroute("**/api/event*")
    page.route("**/api/event*", lambda route: route.abort(), times=1)
    page.reload()
    at_version(page, 1)
    assert len(server.corrections()) == 1


@pytest.mark.slow
def test_a_folder_that_changes_while_open(visit: Open, server: Server) -> None:
    page = visit(server)
    shutil.copy(server.folder / "street_0.png", server.folder / "later.png")
    page.wait_for_selector(".row:has-text('later.png')")
    (server.folder / "street_0.png").unlink()
    tells(page, "notice", "no longer in the folder")
    click(page, 0.5, 0.9, version=1)
    press(page, "n")
    page.wait_for_function("() => document.body.dataset.picture !== 'street_0.png'")
    assert server.corrections()[0].name == "street_0.png"


@pytest.mark.slow
def test_a_refused_stroke_is_told_and_the_next_one_goes_through(
    visit: Open, server: Server
) -> None:
    page = visit(server)
    page.route("**/api/event*", lambda route: route.fulfill(
        status=413, content_type="application/json", body='{"error": "stroke: is too long (x)"}'
    ), times=1)  # fmt: skip
    click(page, 0.5, 0.9)
    tells(page, "notice", "Not kept: stroke")
    assert not list(server.out.rglob("*.jsonl"))
    click(page, 0.5, 0.9, version=1)
    page.wait_for_selector("#notice", state="hidden")
    assert [one.clicks for one in server.corrections()] == [1]


@pytest.mark.slow
@pytest.mark.parametrize("server", [1000], indirect=True)
def test_a_thousand_pictures(visit: Open, server: Server) -> None:
    page = visit(server)
    assert "of 1000" in page.locator("#progress").inner_text()
    assert page.locator(".row").count() < 40
    page.evaluate("document.getElementById('list').scrollTop = 1e6")
    page.locator(".row", has_text="street_999.png").click()
    shown(page, "street_999.png")
    assert page.locator(".row").count() < 40
