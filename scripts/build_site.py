"""Build the site and look for links that lead nowhere.

    python scripts/build_site.py              # docs/ to out/site
    python scripts/build_site.py --out DIR
    python scripts/build_site.py --page FOLDER    # of roadtorch export fusion --format web

Warnings are errors. Afterwards every link inside the site must lead to a file, and to a place in
it; and nothing may be loaded from elsewhere. Links to other sites are not followed.
"""

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
LOADING = {"script", "img", "iframe", "source", "video", "audio", "embed", "object"}
"""Tags whose address a browser fetches by itself; of ``link`` those of ``FETCHED``."""

FETCHED = {"stylesheet", "icon", "preload", "modulepreload", "manifest", "preconnect"}


BROWSER = "browser"
"""Folder of the site that has the page for browsers; docs/try.md leads there."""

WITHOUT_PAGE = """<!doctype html><html lang="en"><title>roadtorch</title>
<p>This site was built without npm, which brings ONNX Runtime for browsers.
<a href="../try.html">How to make the page</a>
"""


class Link(NamedTuple):
    """An address in a page, and whether the browser fetches it without being asked."""

    address: str
    loaded: bool


class PageParser(HTMLParser):
    """Collects the addresses of a page and the names of its places."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[Link] = []
        self.places: set[str] = {"", "top"}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an opening tag."""
        values = {name: value or "" for name, value in attrs}
        self.places.add(values.get("id", ""))
        loaded = tag in LOADING or (tag == "link" and bool(FETCHED & set(values["rel"].split())))
        names = ("src", "data", "poster") if tag in LOADING else ("href",)
        if tag in LOADING | {"a", "link"}:
            self.links += [Link(values[name], loaded) for name in names if name in values]


def build(out: Path) -> None:
    """Build docs/ into a folder; CalledProcessError where Sphinx has anything to warn of."""
    words = ["-m", "sphinx", "-W", "-n", "--keep-going", "-q", "-E", "-d", f"{out}.doctrees"]
    subprocess.run([sys.executable, *words, str(ROOT / "docs"), str(out)], check=True)


def add_page(out: Path, page: Path | None) -> None:
    """Copy the page for browsers into a site; without one, say there how to make it."""
    shutil.rmtree(out / BROWSER, ignore_errors=True)
    if page:
        shutil.copytree(page, out / BROWSER)
    else:
        (out / BROWSER).mkdir()
        (out / BROWSER / "index.html").write_text(WITHOUT_PAGE, encoding="utf-8")


def broken_links(site: Path) -> Iterator[str]:
    """``PAGE: ADDRESS: what is wrong`` for each address that leads nowhere or is fetched."""
    paths = [path for path in site.rglob("*.html") if "_static" not in path.parts]
    pages = {path.resolve(): parsed(path) for path in paths}
    for path, page in sorted(pages.items()):
        for link in page.links:
            wrong = wrong_with(link, path, pages)
            if wrong:
                yield f"{path.relative_to(site.resolve())}: {link.address}: {wrong}"


def parsed(path: Path) -> PageParser:
    """A page's links and places."""
    parser = PageParser()
    parser.feed(path.read_text(encoding="utf-8"))
    return parser


def wrong_with(link: Link, path: Path, pages: dict[Path, PageParser]) -> str:
    """What is wrong with an address of the page at a path; empty if nothing is."""
    parts = urlsplit(link.address)
    if parts.scheme == "data":
        return ""
    if parts.scheme or parts.netloc:
        return "is loaded from elsewhere" if link.loaded else ""
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.exists():
        return "there is no such file"
    if target in pages and unquote(parts.fragment) not in pages[target].places:
        return "there is no such place in it"
    return ""


def main() -> int:
    """Build and check; 1 where links are broken."""
    parser = argparse.ArgumentParser(description="Build the site and check its links.")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "site")
    parser.add_argument("--page", type=Path, help="the page for browsers, to be part of the site")
    options = parser.parse_args()
    out = options.out
    build(out)
    add_page(out, options.page)
    broken = list(broken_links(out))
    print(
        "\n".join(
            [*broken, f"{out}: {len(list(out.rglob('*.html')))} pages, {len(broken)} broken links"]
        )
    )
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
