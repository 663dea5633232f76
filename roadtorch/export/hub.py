"""A folder for a model hub: a detector's weights, its settings, and cards made from theirs."""

import re
import shutil
from pathlib import Path

from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import CONFIG
from roadtorch.export.export import part_of
from roadtorch.io.atomic import atomic, make_folder, write_text
from roadtorch.layout.weights import card_of, terms_of
from roadtorch.settings import to_toml

WEIGHTS, CARD, README = "model.safetensors", "model.md", "README.md"

LINK = re.compile(r"\[([^\]]*)\]\((?!https?:)[^)]*\)")
"""A link of a card to a file of roadtorch's repository, which is not beside it on a hub."""

FRONT = """---
license: {licence}
library_name: roadtorch
pipeline_tag: image-segmentation
tags: [road, segmentation, pytorch]
---

# {name}

Finds the road in a picture. `pip install roadtorch`, and with this folder as FOLDER:

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
    source, settings = part_of(detector).weights, detector.settings
    make_folder(out)
    with atomic(out / WEIGHTS) as temporary:
        shutil.copyfile(source, temporary)
    # ``part_of`` takes detectors alone that have a group of settings for their weights.
    weights = settings.weights.model_copy(update={"file": WEIGHTS})  # type: ignore[attr-defined]
    stored = settings.model_copy(update={"weights": weights})
    write_text(out / CONFIG, to_toml(detector.name, stored))
    licence = "apache-2.0" if terms_of(source).startswith("anything") else "other"
    text, files = FRONT.format(licence=licence, name=f"roadtorch {detector.name}"), []
    if card := card_of(source):
        write_text(out / CARD, LINK.sub(r"\1", card).replace(source.name, WEIGHTS))
        text, files = f"{text}\nWhat the weights learned from: [{CARD}]({CARD}).\n", [out / CARD]
    write_text(out / README, text)
    return (out / WEIGHTS, out / CONFIG, out / README, *files)
