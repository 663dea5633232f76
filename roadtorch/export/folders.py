"""Folders made of a detector: a page that runs it in a browser, and one for model hubs."""

import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

from roadtorch.base.atomic import atomic_write, file_digest, make_folder, write_text
from roadtorch.base.errors import ConfigError
from roadtorch.base.image import to_pixels, write_pixels
from roadtorch.base.settings import to_toml
from roadtorch.detectors.catalogue import DETECTOR_CONFIG
from roadtorch.detectors.detector import Detector
from roadtorch.export.export import ExportResult, export_detector, find_part
from roadtorch.layout.weights import read_card, read_terms
from roadtorch.testing.scenes import render_scene

# --- a page: the network, and ONNX Runtime's web build -----------------------------------

STATIC = Path(__file__).with_name("static")

SERVICE_WORKER = "offline.js"
"""Service worker; its cache is named after the content of the other files."""

RUNTIME_FILES = ("ort.wasm.min.mjs", "ort-wasm-simd-threaded.mjs", "ort-wasm-simd-threaded.wasm")
"""Files that the page needs of onnxruntime-web, an npm package under the MIT licence."""

RUNTIME_VERSION = "1.30.0"

RUNTIME_FOLDER = Path("node_modules/onnxruntime-web/dist")
"""Folder that npm installs it to, below the working directory."""


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
    worker = worker.replace(
        "[]", json.dumps(["./", *(name for name in fetched if name != SERVICE_WORKER)])
    )
    with atomic_write(out / SERVICE_WORKER) as temporary:
        temporary.write_text(worker, encoding="utf-8")
    return replace(exported, files=tuple(out / name for name in fetched))


# --- a folder for model hubs: weights, settings, cards ------------------------------------

README_FILE = "README.md"

HUB_NAMES = {"weights": "model", "second": "second"}
"""File name in the folder of each network, by its group of settings."""

RELATIVE_LINK = re.compile(r"\[([^\]]*)\]\((?!https?:)[^)]*\)")
"""A link of a card to a file of roadtorch's repository, which the folder does not hold."""

HUB_README = """---
license: {licence}
library_name: roadtorch
pipeline_tag: image-segmentation
tags: [road, segmentation, pytorch]
---

# {name}

Detects the road in an image. `pip install roadtorch`, and with this folder as FOLDER:

```python
from roadtorch import load_detector

detection = load_detector("FOLDER")("street.jpg")
detection.mask  # bool (H, W); .likelihood, .trust
```
"""


def export_hub(detector: Detector, out: Path) -> tuple[Path, ...]:
    """Write weights, settings and cards; ``load_detector(out)`` loads the detector from there.

    Returns the files. Raises ConfigError for a detector without a network.
    """
    sources, settings = find_part(detector).weights, detector.settings
    make_folder(out)
    hub_settings, files, cards = settings, [], []
    for (group, name), source in zip(HUB_NAMES.items(), sources, strict=False):
        network = getattr(settings, group).model_copy(update={"file": f"{name}.safetensors"})
        hub_settings = hub_settings.model_copy(update={group: network})
        files.append(out / network.file)
        with atomic_write(files[-1]) as temporary:
            shutil.copyfile(source, temporary)
        if card := read_card(source):
            cards.append(out / f"{name}.md")
            write_text(cards[-1], RELATIVE_LINK.sub(r"\1", card).replace(source.name, network.file))
    write_text(out / DETECTOR_CONFIG, to_toml(detector.name, hub_settings) + "\n")
    is_free = all(read_terms(source).startswith("anything") for source in sources)
    licence = "apache-2.0" if is_free else "other"
    text = HUB_README.format(licence=licence, name=f"roadtorch {detector.name}")
    if cards:
        links = ", ".join(f"[{card.name}]({card.name})" for card in cards)
        text = f"{text}\nTraining data of the weights: {links}.\n"
    write_text(out / README_FILE, text)
    return (*files, out / DETECTOR_CONFIG, out / README_FILE, *cards)
