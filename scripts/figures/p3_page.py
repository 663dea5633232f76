"""P3, Fig. 7: the page for labels."""

import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from roadtorch.base.atomic import atomic_write
from roadtorch.base.errors import ConfigError
from roadtorch.detectors.catalogue import load_detector
from scripts.browser import CHROMIUM
from scripts.figures.chart import COLOURS
from scripts.figures.p3_area import STREET

PAGE_SIZE = 900, 560  # pixels, width and height


@contextmanager
def annotation_page(folder: Path) -> Iterator[str]:
    """Serve the page of `roadtorch annotate` for a folder, and yield its address."""
    from roadtorch.annotate.server import make_page_server
    from roadtorch.annotate.session import open_session

    out = folder / "corrections"
    out.mkdir()
    server = make_page_server(open_session(folder, out, load_detector("fusion")))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield server.address.url
    finally:
        server.stop()
        thread.join()


def fig7(data: Path, out: Path) -> None:
    """Write P3's Fig. 7: the page for labels, after a stroke on a free image.

    It needs Playwright and Chromium (apt: chromium).
    """
    if CHROMIUM is None:
        raise ConfigError("p3-fig7", "needs Chromium", "apt install chromium")
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        shutil.copy(data / "unlabelled_free" / STREET, folder)
        with annotation_page(Path(folder)) as address:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            page = browser.new_page()
            width, height = PAGE_SIZE
            page.set_viewport_size({"width": width, "height": height})
            page.goto(address)
            page.wait_for_selector("body[data-image]")
            page.get_by_text("Got it").click()
            box = page.locator("#stage").bounding_box()
            assert box is not None
            page.keyboard.press("2")
            page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.75 * box["height"])
            page.mouse.down()
            page.mouse.move(box["x"] + 0.95 * box["width"], box["y"] + 0.8 * box["height"], steps=9)
            page.mouse.up()
            page.wait_for_selector("body[data-version='1']")
            page.screenshot(path=str(Path(folder) / "page.png"))
            browser.close()
        few = Image.open(Path(folder) / "page.png").convert("RGB").quantize(COLOURS)
        with atomic_write(out / "p3-fig7.png") as temporary:
            few.save(temporary, format="PNG", optimize=True)
