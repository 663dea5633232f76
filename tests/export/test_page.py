"""The browser page in headless Chromium, from a static file server."""

import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

from roadtorch.base.errors import ConfigError
from roadtorch.base.image import read_image, to_pixels, write_pixels
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detector import Detector
from roadtorch.export import folders as page_module
from roadtorch.export.export import ExportResult
from roadtorch.export.folders import RUNTIME_VERSION, export_page
from roadtorch.testing import street
from scripts.browser import CHROMIUM, PATIENCE, read_state, served, wait_for_status
from tests.export.conftest import NAME

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
for package in ("onnx", "onnxscript", "onnxruntime"):
    pytest.importorskip(package, reason="the extra onnx is not installed")

BROWSER = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium (apt: chromium)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, fusion: ExportResult) -> Path:
    """Write the page, with the runtime from npm."""
    if shutil.which("npm") is None:
        pytest.skip("npm, which brings onnxruntime-web, is not installed")
    root = tmp_path_factory.mktemp("page")
    words = ["npm", "install", "--silent", f"onnxruntime-web@{RUNTIME_VERSION}"]
    installed = subprocess.run(words, cwd=root, capture_output=True, text=True, check=False)
    if installed.returncode:
        pytest.skip(f"npm does not bring onnxruntime-web: {installed.stderr[-200:]}")

    def exported(_: Detector, out: Path) -> ExportResult:
        out.parent.mkdir()
        return replace(fusion, files=(shutil.copy(fusion.files[0], out),))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page_module, "export_detector", exported)
        patch.chdir(root)
        export_page(load_detector(NAME), root / "page")
    return root / "page"


@pytest.fixture(scope="module")
def browser() -> Iterator["Browser"]:
    arguments = ["--no-sandbox", "--use-fake-device-for-media-stream"]
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser: "Browser", folder: Path) -> Iterator["Page"]:
    """Open the page and wait until it is ready."""
    with served(folder) as address:
        context = browser.new_context(permissions=["camera"])
        context.set_default_timeout(PATIENCE)
        page = context.new_page()
        page.goto(address)
        wait_for_status(page, "Ready")
        yield page
        context.close()


@BROWSER
def test_masks_and_trust_are_those_of_python(page: "Page", tmp_path: Path) -> None:
    detector = load_detector(NAME)
    for name, size in (("a.png", (240, 320)), ("b.png", (333, 500)), ("wide.png", (120, 400))):
        write_pixels(tmp_path / name, to_pixels(street(*size, len(name))))
        state = read_state(page, tmp_path / name)
        detection = detector.detect(read_image(tmp_path / name))
        assert detection.trust is not None
        assert (state["mask"] != detection.mask.numpy()).mean() <= 0.005, name
        assert abs(state["trust"] - detection.trust) <= 0.02, name


@BROWSER
def test_the_page_requests_no_other_host_and_opens_offline(page: "Page") -> None:
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.evaluate("navigator.serviceWorker.ready")
    page.wait_for_function("navigator.serviceWorker.controller")
    page.context.set_offline(True)

    page.reload()
    wait_for_status(page, "Ready")
    page.click("#example")
    wait_for_status(page, "A rendered street")

    assert page.evaluate("roadtorch.state().mask.includes(1)")
    origin = page.evaluate("location.origin")
    assert all(url.startswith((origin, f"blob:{origin}")) for url in requests), requests


@BROWSER
def test_the_camera_by_keyboard_and_files_that_cannot_be_read(page: "Page", tmp_path: Path) -> None:
    for _ in range(2):  # the file, the camera
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_function("document.getElementById('time').textContent.includes('a second')")
    page.click("#stop")
    wait_for_status(page, "Stopped.")
    assert page.is_hidden("#stop")

    text, large = tmp_path / "notes.jpg", tmp_path / "large.png"
    text.write_text("no image")
    Image.new("1", (11_000, 10_000)).save(large)
    for path, message in (
        (text, "notes.jpg is not an image or video that this browser reads."),
        (large, "large.png has 110 megapixels: more than 100. Reduce its size."),
    ):
        page.set_input_files("#file", path)
        wait_for_status(page, message)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("layout:cnn-7", "layout:cnn-7: cannot run in a page"),
        ("fusion", r"is missing or incomplete \(run npm install onnxruntime-web@"),
    ],
)
def test_detectors_without_a_page_are_refused_before_any_work(
    name: str, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "RUNTIME_FOLDER", tmp_path / "nowhere")

    with pytest.raises(ConfigError, match=problem):
        export_page(load_detector(name), tmp_path / "page")

    assert not (tmp_path / "page").exists()
