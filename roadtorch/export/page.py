"""A folder that finds the road in a browser: a page, the network, ONNX Runtime's web build."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

from roadtorch.base.atomic import atomic, digest_of
from roadtorch.base.errors import ConfigError
from roadtorch.base.image import to_pixels, write_pixels
from roadtorch.detectors.detector import Detector
from roadtorch.export.export import Exported, export_detector
from roadtorch.testing.scenes import render_scene

STATIC = Path(__file__).with_name("static")

OFFLINE = "offline.js"
"""The service worker; it keeps the others under a name that changes with any of them."""

RUNTIME = ("ort.wasm.min.mjs", "ort-wasm-simd-threaded.mjs", "ort-wasm-simd-threaded.wasm")
"""What the page needs of onnxruntime-web, an npm package under the MIT licence."""

RUNTIME_VERSION = "1.30.0"

RUNTIME_FOLDER = Path("node_modules/onnxruntime-web/dist")
"""Where npm puts it, below the folder in which it is called."""


def export_page(detector: Detector, out: Path) -> Exported:
    """Write the folder; the runtime is copied from ``RUNTIME_FOLDER``.

    Raises ConfigError where that is not there, for a detector whose graph has no trust, and as
    ``export_detector``.
    """
    if not detector.name.startswith("fusion"):
        raise ConfigError(detector.name, "has no page", "take fusion or fusion:large")
    if any(not (RUNTIME_FOLDER / name).is_file() for name in RUNTIME):
        remedy = f"npm install onnxruntime-web@{RUNTIME_VERSION}, in the folder you are in"
        raise ConfigError(RUNTIME_FOLDER, "is not there or incomplete", remedy)
    exported = export_detector(detector, out / "road.onnx")
    write_pixels(out / "street.jpg", to_pixels(render_scene(2, 360, 640).image))
    sources = [*sorted(STATIC.iterdir()), *(RUNTIME_FOLDER / name for name in RUNTIME)]
    digests = "".join(digest_of(path) for path in (exported.files[0], *sources))
    fetched = ["road.onnx", "street.jpg", *(source.name for source in sources)]
    for source in sources:
        with atomic(out / source.name) as temporary:
            shutil.copyfile(source, temporary)
    worker = (STATIC / OFFLINE).read_text(encoding="utf-8")
    worker = worker.replace("VERSION", hashlib.sha256(digests.encode()).hexdigest()[:12])
    worker = worker.replace(
        "[]", json.dumps(["./", *(name for name in fetched if name != OFFLINE)])
    )
    with atomic(out / OFFLINE) as temporary:
        temporary.write_text(worker, encoding="utf-8")
    return replace(exported, files=tuple(out / name for name in fetched))
