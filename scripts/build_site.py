"""Build the site and look for links that lead nowhere.

    python scripts/build_site.py              # docs/ to out/site
    python scripts/build_site.py --out DIR
    python scripts/build_site.py --page FOLDER    # of roadtorch export fusion --format web

Warnings are errors. Afterwards every link inside the site must lead to a file, and to a place in
it; and nothing may be loaded from elsewhere. Links to other sites are not followed.
"""

import shutil
import subprocess
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator, Mapping
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
ADDRESSES = {"a": "href", "link": "href", "object": "data", "video": "poster"}
"""Where tags have their address; others, and a video as well, in ``src``."""

BROWSER = "browser"
"""Folder of the site that has the page for browsers; docs/export.md leads there."""

WITHOUT_PAGE = """<!doctype html><html lang="en"><title>roadtorch</title>
<p>This site was built without npm, which brings ONNX Runtime for browsers.
<a href="../export.html#browser">How to make the page</a>
"""


class PageParser(HTMLParser):
    """The addresses of a page, with the tags that have them, and its anchors."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[tuple[str, str]] = []
        self.anchors: set[str] = {"", "top"}
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record the addresses and the anchor of an opening tag."""
        values = {name: value or "" for name, value in attrs}
        self.anchors.add(values.get("id", ""))
        if tag == "link" and not FETCHED & set(values["rel"].split()):
            tag = "a"
        names = {"src", ADDRESSES.get(tag, "src")}
        self.links += [(tag, values[name]) for name in names if name in values]


FETCHED = {"stylesheet", "icon", "preload", "modulepreload", "manifest", "preconnect"}
"""Links whose address a browser fetches by itself, as it does of every tag but ``a``."""


def build(out: Path) -> None:
    """Build docs/ into a folder; CalledProcessError if Sphinx reports a warning."""
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
    """Yield ``PAGE: ADDRESS: problem`` for each address without a target or that is fetched."""
    paths = [path.resolve() for path in site.rglob("*.html") if "_static" not in path.parts]
    pages = {path: PageParser(path) for path in paths}
    for path, page in sorted(pages.items()):
        for tag, address in page.links:
            if wrong := wrong_with(tag, address, path, pages):
                yield f"{path.relative_to(site.resolve())}: {address}: {wrong}"


def wrong_with(tag: str, address: str, path: Path, pages: Mapping[Path, PageParser]) -> str:
    """Return the problem of an address of the page at a path; empty if there is none."""
    parts = urlsplit(address)
    if parts.scheme == "data":
        return ""
    if parts.scheme or parts.netloc:
        return "" if tag == "a" else "is loaded from elsewhere"
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.exists():
        return "there is no such file"
    if target in pages and unquote(parts.fragment) not in pages[target].anchors:
        return "there is no such place in it"
    return ""


def main() -> int:
    """Build and check; return 1 where links are broken."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "site")
    parser.add_argument("--page", type=Path, help="the page for browsers, to be part of the site")
    options = parser.parse_args()
    build(options.out)
    add_page(options.out, options.page)
    broken = list(broken_links(options.out))
    print(
        *broken,
        f"{len(list(options.out.rglob('*.html')))} pages, {len(broken)} broken links",
        sep="\n",
    )
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
