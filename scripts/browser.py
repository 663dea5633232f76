"""The page for browsers beside Python, on the same pictures in one run: masks, trust, times.

python scripts/browser.py PAGE PICTURE… [--threads]

PAGE: the folder of ``roadtorch export fusion --format web``. It needs Playwright and Chromium
(apt: chromium). --threads: serve it with the headers that let a page take more than one.
"""

import argparse
import shutil
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from roadtorch.base.image import read_image
from roadtorch.detectors.catalogue import load_detector

if TYPE_CHECKING:
    from playwright.sync_api import Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

PATIENCE = 60_000  # milliseconds

ALONE = (
    ("Cross-Origin-Opener-Policy", "same-origin"),
    ("Cross-Origin-Embedder-Policy", "require-corp"),
)


@contextmanager
def served(folder: Path, *headers: tuple[str, str]) -> Iterator[str]:
    """The address of a folder, on the loopback."""

    class Handler(SimpleHTTPRequestHandler):
        def end_headers(self) -> None:
            for name, value in headers:
                self.send_header(name, value)
            super().end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://localhost:{server.server_port}/"
    server.shutdown()
    server.server_close()


def wait_for_status(page: "Page", begins: str) -> None:
    """Wait until the page's status begins with a text."""
    script = "begins => document.getElementById('status').textContent.startsWith(begins)"
    page.wait_for_function(script, arg=begins)


def looked_at(page: "Page", path: Path) -> dict[str, Any]:
    """What the page finds in a file: mask bool (H,W), trust, and ms that it took."""
    page.set_input_files("#file", path)
    wait_for_status(page, path.name)
    script = "(({mask, width, trust, ms}) => ({mask: [...mask], width, trust, ms}))"
    state = page.evaluate(f"{script}(roadtorch.state())")
    state["mask"] = np.array(state["mask"], dtype=bool).reshape(-1, state["width"])
    return state


def measured(page: "Page", paths: list[Path]) -> list[tuple[float, float, float, float]]:
    """Of each picture: share of pixels that differ, trust's difference, both times in ms."""
    detector, rows = load_detector("fusion"), []
    torch.set_num_threads(1)
    for path in paths:
        image = read_image(path)
        start = time.perf_counter()
        detection = detector.detect(image)
        elapsed = 1000 * (time.perf_counter() - start)
        state = looked_at(page, path)
        apart = float((state["mask"] != detection.mask.numpy()).mean())
        rows.append((apart, abs(state["trust"] - (detection.trust or 0)), state["ms"], elapsed))
    return rows


def main() -> None:
    """Print what was measured."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("page", type=Path)
    parser.add_argument("pictures", type=Path, nargs="+")
    parser.add_argument("--threads", action="store_true")
    options = parser.parse_args()
    with (
        served(options.page, *(ALONE if options.threads else ())) as address,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.set_default_timeout(PATIENCE)
        start = time.perf_counter()
        page.goto(address)
        wait_for_status(page, "Ready")
        ready = time.perf_counter() - start
        threads = page.inner_text("#status")
        rows = measured(page, options.pictures)
        browser.close()
    size = sum(path.stat().st_size for path in options.page.iterdir()) / 1e6
    apart, trust, browser_ms, python_ms = zip(*rows, strict=True)
    print(f"{size:.1f} MB, {threads.lower().rstrip('.')} after {ready:.1f} s")
    print(
        f"{len(rows)} pictures; of the pixels differ: "
        f"median {statistics.median(apart):.2%}, most {max(apart):.2%}"
    )
    print(f"trust differs: median {statistics.median(trust):.4f}, most {max(trust):.4f}")
    print(
        f"ms a picture, medians: browser {statistics.median(browser_ms):.0f}, "
        f"Python on one thread {statistics.median(python_ms):.0f}"
    )


if __name__ == "__main__":
    main()
