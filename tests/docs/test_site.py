"""The site: it builds without a warning, its links lead somewhere, the reference is complete."""

import re
import shutil
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import roadtorch
from roadtorch.cli.group import COMMANDS
from roadtorch.detectors.catalogue import ENTRIES
from roadtorch.oneclass import CLASSIFIERS
from scripts.build_site import broken_links
from tests.docs.conftest import ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PATIENCE = 60_000  # milliseconds; a loaded machine is slow

in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium (apt: chromium)")


# --- pages --------------------------------------------------------------------------------


def test_no_link_inside_leads_nowhere_and_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    assert list(broken_links(site)) == []


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        ('<a href="none.html">x</a>', "there is no such file"),
        ('<a href="#none">x</a>', "there is no such place in it"),
        ('<script src="https://cdn.example/x.js"></script>', "is loaded from elsewhere"),
        ('<link rel="stylesheet" href="//fonts.example/x.css">', "is loaded from elsewhere"),
    ],
)
def test_a_planted_fault_is_found(tmp_path: Path, body: str, wrong: str) -> None:
    (tmp_path / "page.html").write_text(body)

    (told,) = broken_links(tmp_path)
    assert told.endswith(wrong)


TABLE = re.compile(r"<!-- table: \S+ -->\n.*?<!-- end -->", re.S)


@pytest.mark.parametrize(("research", "most"), [(False, 22_000), (True, 12_000)])
def test_pages_have_no_more_words_than_anybody_reads(research: bool, most: int) -> None:
    """What people wrote; not what is made of code and records, nor comments."""
    texts = {
        path: re.sub("<!--.*?-->", "", TABLE.sub("", path.read_text(encoding="utf-8")))
        for path in (ROOT / "docs").rglob("*.md")
        if ("research" in path.parts) == research
    }

    assert sum(len(text.split()) for text in texts.values()) <= most


@cache
def words_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_every_command_and_detector_is_in_the_reference(site: Path) -> None:
    commands = words_of(site / "reference" / "commands.html")
    pages = "".join(words_of(path) for path in (site / "reference" / "settings").glob("*.html"))
    names = [entry.name.replace(":", "-") for entry in ENTRIES if not entry.grid]

    assert [name for name in COMMANDS if f'id="command-{name}"' not in commands] == []
    assert [name for name in names if f'id="settings-{name}"' not in pages] == []
    assert [name for name in CLASSIFIERS if f'id="{name.replace("_", "-")}"' not in pages] == []


def inventory(site: Path) -> str:
    """What objects.inv lists: a line for each name that can be linked to."""
    packed = (site / "objects.inv").read_bytes().split(b"\n", 4)[4]
    return zlib.decompress(packed).decode()


def test_every_public_name_is_explained(site: Path) -> None:
    known = {line.split(" ")[0] for line in inventory(site).splitlines()}
    public = [getattr(roadtorch, name) for name in roadtorch.__all__ if name != "__version__"]

    assert [one for one in public if f"{one.__module__}.{one.__qualname__}" not in known] == []


def test_equations_are_mathml(site: Path) -> None:
    assert words_of(site / "how" / "layout_texture.html").count("<math ") > 5


# --- in a browser -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    with sync_api.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def page(browser: "Browser") -> "Iterator[Page]":
    """A page that fails the test where anything but files is asked for."""
    context = browser.new_context()
    context.set_default_timeout(PATIENCE)
    asked: list[str] = []
    opened = context.new_page()
    opened.on("request", lambda request: asked.append(request.url))
    yield opened
    context.close()
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


@in_a_browser
@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("bonnet", "camera.html"),
        pytest.param("--save", "commands.html", marks=pytest.mark.slow),
        pytest.param(
            "minimum_variance_weights", "reference/api/steps.html", marks=pytest.mark.slow
        ),
    ],
)
def test_the_search_works_without_a_network(
    site: Path, page: "Page", query: str, found: str
) -> None:
    page.goto(f"{(site / 'search.html').as_uri()}?q={query}")

    assert page.wait_for_selector(f'#search-results a[href*="{found}"]')


@in_a_browser
@pytest.mark.parametrize(
    ("name", "width"),
    [
        ("reference/commands", 390),
        *(
            pytest.param(name, width, marks=pytest.mark.slow)
            for name in ("index", "how/features", "results", "research/papers")
            for width in (390, 1280)
        ),
    ],
)
def test_no_page_is_wider_than_its_window(site: Path, page: "Page", name: str, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    page.goto((site / f"{name}.html").as_uri())

    root = "document.documentElement"
    assert page.evaluate(f"{root}.scrollWidth <= {root}.clientWidth")
