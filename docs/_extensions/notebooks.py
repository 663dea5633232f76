"""A page with executed blocks as a notebook, which ``scripts/tutorials.py write`` writes."""

import json
import re
from base64 import b64decode, b64encode
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

JPEG = re.compile('(?<="image/jpeg": ")[^"]+')
LEVELS = 1
"""Mean difference of two images' levels up to which they are the same: roundings."""


def same_notebook(expected: str, actual: str) -> bool:
    """Return whether two notebooks have the same text, and images up to roundings."""
    images = [
        [cv2.imdecode(np.frombuffer(b64decode(data), np.uint8), 1) for data in JPEG.findall(text)]
        for text in (expected, actual)
    ]
    return JPEG.sub("", expected) == JPEG.sub("", actual) and all(
        a.shape == b.shape and cv2.absdiff(a, b).mean() < LEVELS
        for a, b in zip(*images, strict=True)
    )


def as_notebook(page: str, block: re.Pattern[str], images: Sequence[bytes]) -> str:
    """Return a page as a notebook.

    Commands become those of the kernel's Python, whatever PATH has.

    Args:
        page: Markdown with what its blocks print.
        block: pattern of a block, its kind (``console``, ``python`` or ``text``) and its text.
        images: JPEG that each block ``python`` shows; empty where it shows none.
    """
    first, *pieces = block.split(page.partition("```{toctree}")[0])
    cells: list[dict[str, Any]] = [{"cell_type": "markdown", "metadata": {}, "source": first}]
    left = iter(images)
    for kind, text, after in zip(pieces[::3], pieces[1::3], pieces[2::3], strict=True):
        printed, cell = text, {"cell_type": "code", "metadata": {}, "execution_count": None}
        if kind == "console":
            lines = text.splitlines()
            commands = [line[2:].removeprefix("python -m ") for line in lines if line[:2] == "$ "]
            printed = "\n".join(line for line in lines if line[:2] != "$ ")
            source = "\n!{sys.executable} -m ".join(["import sys", *commands])
            cells.append(cell | {"source": source, "outputs": []})
        elif kind == "python":
            data = {"image/jpeg": b64encode(next(left)).decode()}
            shown = {"output_type": "display_data", "data": data, "metadata": {}}
            cells.append(cell | {"source": text.strip(), "outputs": [shown] * any(data.values())})
        if kind != "python":
            stream = {"output_type": "stream", "name": "stdout", "text": printed}
            cells[-1]["outputs"].append(stream)
        if after.strip():
            cells.append({"cell_type": "markdown", "metadata": {}, "source": after.strip()})
    notebook = {"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 4}
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
