"""A page that runs a detector in a browser: the network, and ONNX Runtime's web build."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

from roadtorch.base.atomic import atomic_write, file_digest
from roadtorch.base.errors import ConfigError
from roadtorch.base.image import to_pixels, write_pixels
from roadtorch.detectors.detector import Detector
from roadtorch.export.export import ExportResult, export_detector
from roadtorch.testing.scenes import render_scene

STATIC = Path(__file__).with_name("static")

SERVICE_WORKER = "offline.js"  # its cache is named after the content of the other files

RUNTIME_FILES = ("ort.wasm.min.mjs", "ort-wasm-simd-threaded.mjs", "ort-wasm-simd-threaded.wasm")
"""Files that the page needs of onnxruntime-web, an npm package under the MIT licence."""

WEB_FILES = ("road.onnx", "street.jpg", *(f.name for f in STATIC.iterdir()), *RUNTIME_FILES)

RUNTIME_VERSION = "1.30.0"
RUNTIME_FOLDER = Path("node_modules/onnxruntime-web/dist")  # where npm installs it


def export_page(detector: Detector, out: Path) -> ExportResult:
    """Write the folder of a page; the runtime is copied from ``RUNTIME_FOLDER``.

    Raises ConfigError where the runtime is missing, for a detector whose graph has no trust, and as
    ``export_detector`` does.
    """
    if not detector.name.startswith("fusion"):
        raise ConfigError(detector.name, "cannot run in a page", "use fusion or fusion:large")
    if any(not (RUNTIME_FOLDER / name).is_file() for name in RUNTIME_FILES):
        hint = f"run npm install onnxruntime-web@{RUNTIME_VERSION} in the current folder"
        raise ConfigError(RUNTIME_FOLDER, "is missing or incomplete", hint)
    exported = export_detector(detector, out / "road.onnx")
    write_pixels(out / "street.jpg", to_pixels(render_scene(2, 360, 640).image))
    sources = [*sorted(STATIC.iterdir()), *(RUNTIME_FOLDER / name for name in RUNTIME_FILES)]
    digests = "".join(file_digest(path) for path in (exported.files[0], *sources))
    fetched = ["road.onnx", "street.jpg", *(source.name for source in sources)]
    for source in sources:
        with atomic_write(out / source.name) as temporary:
            shutil.copyfile(source, temporary)
    worker = (STATIC / SERVICE_WORKER).read_text(encoding="utf-8")
    worker = worker.replace("VERSION", hashlib.sha256(digests.encode()).hexdigest()[:12])
    listed = json.dumps(["./", *(name for name in fetched if name != SERVICE_WORKER)])
    worker = worker.replace("[]", listed)
    with atomic_write(out / SERVICE_WORKER) as temporary:
        temporary.write_text(worker, encoding="utf-8")
    return replace(exported, files=tuple(out / name for name in fetched))
