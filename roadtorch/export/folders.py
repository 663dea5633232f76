"""Folders made of a detector: a page that finds the road in a browser, and one for model hubs."""

import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

from roadtorch.base.atomic import atomic, digest_of, make_folder, write_text
from roadtorch.base.errors import ConfigError
from roadtorch.base.image import to_pixels, write_pixels
from roadtorch.base.settings import to_toml
from roadtorch.detectors.catalogue import CONFIG
from roadtorch.detectors.detector import Detector
from roadtorch.export.export import Exported, export_detector, part_of
from roadtorch.layout.weights import card_of, terms_of
from roadtorch.testing.scenes import render_scene

# --- a page: the network, and ONNX Runtime's web build -----------------------------------

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
        hint = f"npm install onnxruntime-web@{RUNTIME_VERSION}, in the folder you are in"
        raise ConfigError(RUNTIME_FOLDER, "is not there or incomplete", hint)
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


# --- a model hub: weights, settings, and cards made from theirs --------------------------


README = "README.md"

NAMES = {"weights": "model", "second": "second"}
"""What the files of a network are called: its group of settings, and their name in the folder."""

LINK = re.compile(r"\[([^\]]*)\]\((?!https?:)[^)]*\)")
"""A link of a card to a file of roadtorch's repository, which is not beside it on a hub."""

FRONT = """---
license: {licence}
library_name: roadtorch
pipeline_tag: image-segmentation
tags: [road, segmentation, pytorch]
---

# {name}

Finds the road in an image. `pip install roadtorch`, and with this folder as FOLDER:

```python
from roadtorch import load_detector

detection = load_detector("FOLDER")("street.jpg")
detection.mask  # bool (H,W); .likelihood, .trust
```
"""


def export_folder(detector: Detector, out: Path) -> tuple[Path, ...]:
    """Write weights, settings and cards; ``load_detector(out)`` makes the detector again.

    Returns the files. Raises ConfigError for a detector without a network of its own.
    """
    sources, settings = part_of(detector).weights, detector.settings
    make_folder(out)
    stored, files, cards = settings, [], []
    for (group, name), source in zip(NAMES.items(), sources, strict=False):
        own = getattr(settings, group).model_copy(update={"file": f"{name}.safetensors"})
        stored = stored.model_copy(update={group: own})
        files.append(out / own.file)
        with atomic(files[-1]) as temporary:
            shutil.copyfile(source, temporary)
        if card := card_of(source):
            cards.append(out / f"{name}.md")
            write_text(cards[-1], LINK.sub(r"\1", card).replace(source.name, own.file))
    write_text(out / CONFIG, to_toml(detector.name, stored))
    free = all(terms_of(source).startswith("anything") for source in sources)
    licence = "apache-2.0" if free else "other"
    text = FRONT.format(licence=licence, name=f"roadtorch {detector.name}")
    if cards:
        links = ", ".join(f"[{card.name}]({card.name})" for card in cards)
        text = f"{text}\nWhat the weights learned from: {links}.\n"
    write_text(out / README, text)
    return (*files, out / CONFIG, out / README, *cards)
