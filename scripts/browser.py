"""Compare the page for browsers with Python on the same images: masks, trust, times.

    python scripts/browser.py PAGE IMAGE…

PAGE: the folder of ``roadtorch export fusion --format web``. It needs Playwright and Chromium
(apt: chromium).
"""

import shutil
import threading
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from roadtorch.base.image import read_image
from roadtorch.detectors.catalogue import load_detector

if TYPE_CHECKING:
    from playwright.sync_api import Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

PATIENCE = 300_000  # milliseconds


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder on the loopback and yield its address."""

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

    handler = partial(Handler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_port}/"
        server.shutdown()


def wait_for_status(page: "Page", begins: str) -> None:
    """Wait until the page's status begins with a text."""
    script = "begins => document.getElementById('status').textContent.startsWith(begins)"
    page.wait_for_function(script, arg=begins)


def read_state(page: "Page", path: Path) -> dict[str, Any]:
    """Return the page's result for a file: mask bool (H, W), trust, and milliseconds."""
    page.set_input_files("#file", path)
    wait_for_status(page, path.name)
    script = "(({mask, width, trust, ms}) => ({mask: [...mask], width, trust, ms}))"
    state = page.evaluate(f"{script}(roadtorch.state())")
    state["mask"] = np.array(state["mask"], dtype=bool).reshape(-1, state["width"])
    return state


def main() -> None:
    """Print the differences of masks and trust, and the time for an image."""
    from playwright.sync_api import sync_playwright

    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("images", type=Path, nargs="+")
    options = parser.parse_args()
    detector, rows = load_detector("fusion"), []
    torch.set_num_threads(1)
    with served(options.page) as address, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.set_default_timeout(PATIENCE)
        start = time.perf_counter()
        page.goto(address)
        wait_for_status(page, "Ready")
        ready = time.perf_counter() - start
        status = page.inner_text("#status").lower().rstrip(".")
        for path in options.images:
            image = read_image(path)
            start = time.perf_counter()
            detection = detector.detect(image)
            elapsed = 1000 * (time.perf_counter() - start)
            state = read_state(page, path)
            differ = float((state["mask"] != detection.mask.numpy()).mean())
            trust = abs(state["trust"] - (detection.trust or 0))
            rows.append((differ, trust, state["ms"], elapsed))
        browser.close()
    size = sum(path.stat().st_size for path in options.page.iterdir()) / 1e6
    differ, trust, browser_ms, python_ms = zip(*rows, strict=True)
    print(f"{size:.1f} MB, {status} after {ready:.1f} s")
    print(f"{len(rows)} images")
    print(f"pixels differ: median {median(differ):.2%}, most {max(differ):.2%}")
    print(f"trust differs: median {median(trust):.4f}, most {max(trust):.4f}")
    print(f"ms an image: browser {median(browser_ms):.0f}, Python {median(python_ms):.0f}")


if __name__ == "__main__":
    main()
