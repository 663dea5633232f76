"""Sheets of images: free streets in columns, a row for each step of a method."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from torch import Tensor

from roadtorch.base.atomic import atomic_write
from roadtorch.base.image import read_image
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth

PHOTOS = (
    *("udadv_test2.jpg", "driveai_us_019.jpg", "safroad_0004.jpg", "brno_0006.jpg"),
    "rddmix_0025.jpg",
)
"""A motorway, two suburbs, a city, a village, of unlabelled_free/."""

RENDERED = ("carla_lyft/carla_lyft_cc0_023", "carlarain/seqTown03Clear_001814")
"""Streets of simulated/, whose truth the renderer knows."""

LABELLED = (
    *("comma10k/0006_0c5c849415c7dba2_2018-08-12", "comma10k/0004_2ac95059f70d76eb_2018-05-12"),
    *("dn_mcubes/multimodal-m_h01", "dn_mcubes/multimodal-m_h04"),
    *("dn_cat/cat_h10", "dn_cat/cat_v06"),
)
"""Images of many/ with human labels that are free for any use: MIT, MIT, CC BY 4.0."""

TILE = 140, 90  # pixels, width and height
CAPTION = 13  # pixels, above each row
QUALITY = 72  # of JPEG
WHITE, BLACK = (255, 255, 255), (0, 0, 0)


def read_labelled(
    data: Path, folder: str = "many", names: Sequence[str] | None = None
) -> list[tuple[Tensor, Truth]]:
    """Read images of a folder of the data by their names and their truth, ``LABELLED`` if None."""
    dataset = open_dataset("folder", data / folder)
    by_name = {item.name: item for item in dataset.items}
    return [dataset.read(by_name[name]) for name in names or LABELLED]


def read_streets(data: Path) -> list[tuple[Tensor, Truth | None]]:
    """Read the photos, then the rendered streets with their truth."""
    photos = [(read_image(data / "unlabelled_free" / name), None) for name in PHOTOS]
    return [*photos, *read_labelled(data, "simulated", RENDERED)]


def write_sheet(
    path: Path, rows: Mapping[str, Sequence[np.ndarray | None]], tile: tuple[int, int] = TILE
) -> None:
    """Write rows of tiles, each RGB uint8 (H, W, 3), under their captions, as JPEG.

    A tile is scaled to ``tile`` (width, height) whatever its shape; None is left blank.
    """
    width, height = tile
    columns = max(map(len, rows.values()))
    parts = []
    for caption, tiles in rows.items():
        part = np.full((CAPTION + height, columns * width, 3), WHITE, np.uint8)
        cv2.putText(part, caption, (2, 10), cv2.FONT_HERSHEY_SIMPLEX, 0.36, BLACK, 1, cv2.LINE_AA)
        for column, pixels in enumerate(tiles):
            if pixels is not None:
                left = column * width
                inside = cv2.resize(pixels, (width - 2, height), interpolation=cv2.INTER_AREA)
                part[CAPTION:, left : left + width - 2] = inside
        parts.append(part)
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    encoded = cv2.imencode(".jpg", np.ascontiguousarray(np.vstack(parts)[..., ::-1]), options)[1]
    with atomic_write(path) as temporary:
        temporary.write_bytes(encoded.tobytes())
