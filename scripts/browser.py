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
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import torch
from playwright.sync_api import Page, sync_playwright

from roadtorch.detectors.catalogue import load_detector
from roadtorch.io.image import read_image

ALONE = {
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
}
STATE = "(({mask, width, trust, ms}) => ({mask: [...mask], width, trust, ms}))(roadtorch.state())"


class Handler(SimpleHTTPRequestHandler):
    """Serves a folder; ``headers`` go with every file."""

    headers_of_all: dict[str, str]

    def end_headers(self) -> None:
        """Add the headers."""
        for name, value in self.headers_of_all.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def status(page: Page, begins: str) -> None:
    """Wait until the page's status begins with a text."""
    script = "begins => document.getElementById('status').textContent.startsWith(begins)"
    page.wait_for_function(script, arg=begins, timeout=120_000)


def measured(page: Page, paths: list[Path]) -> list[tuple[float, float, float, float]]:
    """Of each picture: share of pixels that differ, trust's difference, both times in ms."""
    detector, rows = load_detector("fusion"), []
    torch.set_num_threads(1)
    for path in paths:
        image = read_image(path)
        start = time.perf_counter()
        detection = detector.detect(image)
        elapsed = 1000 * (time.perf_counter() - start)
        page.set_input_files("#file", path)
        status(page, path.name)
        state = page.evaluate(STATE)
        mask = np.array(state["mask"], dtype=bool).reshape(-1, state["width"])
        apart = float((mask != detection.mask.numpy()).mean())
        rows.append((apart, abs(state["trust"] - (detection.trust or 0)), state["ms"], elapsed))
    return rows


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("page", type=Path)
    parser.add_argument("pictures", type=Path, nargs="+")
    parser.add_argument("--threads", action="store_true")
    options = parser.parse_args()
    Handler.headers_of_all = ALONE if options.threads else {}
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(options.page)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        start = time.perf_counter()
        page.goto(f"http://localhost:{server.server_port}/")
        status(page, "Ready")
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
