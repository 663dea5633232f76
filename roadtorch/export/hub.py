"""A folder for a model hub: a detector's weights, its settings, and cards made from theirs."""

import re
import shutil
from pathlib import Path

from roadtorch.base.atomic import atomic, make_folder, write_text
from roadtorch.base.settings import to_toml
from roadtorch.detectors.catalogue import CONFIG
from roadtorch.detectors.detector import Detector
from roadtorch.export.export import part_of
from roadtorch.layout.weights import card_of, terms_of

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
