"""Corrections by people: what was said about each picture, in what time.

``read_corrections`` is what training and reports start from.
"""

import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import torch
from PIL.ExifTags import Base as ExifTag

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.decoding import open_picture, without_warnings
from roadtorch.base.errors import DatasetError
from roadtorch.data.correction_labels import (
    NOT_ROAD,
    ROAD_SAID,
    layout_layer,
    road_layer,
)
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.data.events import ENDING, click_count, read_log, read_logs
from roadtorch.layout.classes import UNLABELLED

TURNED = (5, 6, 7, 8)  # EXIF orientations that swap width and height


@dataclass(frozen=True, eq=False)
class Correction:
    """What a person said about one picture.

    picture: its file. name: relative to the folder of pictures, with ending. labels: uint8 (H,W),
    numbers of ``LABELS``. confirmed: said to be right as it is, so that every pixel's road is
    known. seconds: at work on it. clicks: strokes, those taken back among them. log: where it was
    said.
    """

    picture: Path
    name: str
    labels: np.ndarray
    confirmed: bool
    seconds: float
    clicks: int
    log: Path

    @property
    def road(self) -> np.ndarray:
        """uint8 (H,W): 1 road, 0 not road, 254 void, 255 untouched."""
        return road_layer(self.labels)

    @property
    def layout(self) -> np.ndarray:
        """uint8 (H,W): 0 sky, 1 vertical, 2 horizontal, 255 untouched."""
        return layout_layer(self.labels)

    @property
    def says_road(self) -> np.ndarray:
        """bool (H,W): where it is said whether there is road."""
        return (self.road == ROAD_SAID) | (self.road == NOT_ROAD)


def read_corrections(folder: Path, pictures: Path | None = None) -> list[Correction]:
    """Read what is known of each picture that was worked on, sorted by name.

    folder: where ``roadtorch annotate`` keeps its logs. pictures: their folder, if it moved;
    else the logs know. Pictures on which every stroke was taken back are left out. Raises
    DatasetError for a folder without logs, and for a broken one.
    """
    logs = read_logs(folder)
    if not logs:
        raise DatasetError(folder, "holds no corrections", "make some with roadtorch annotate")
    corrections = []
    for log in logs:
        name = log.path.relative_to(folder).as_posix().removesuffix(ENDING)
        logged = Path(os.path.normpath(folder / log.head.picture))
        corrections.append(
            Correction(
                pictures / name if pictures else logged,
                name,
                log.labels,
                log.confirmed,
                sum(event.seconds for event in log.events),
                click_count(log.events),
                log.path,
            )
        )
    corrections.sort(key=lambda correction: correction.name)
    return [correction for correction in corrections if (correction.labels > 0).any()]


def picture_size(path: Path) -> tuple[int, int]:
    """Return (height, width) of a picture as it is shown, from its header.

    Raises DatasetError when it cannot be opened.
    """
    try:
        with open_picture(read_regular(path)) as picture, without_warnings():
            turned = picture.getexif().get(ExifTag.Orientation) in TURNED
            return (picture.width, picture.height) if turned else (picture.height, picture.width)
    except Exception as problem:
        message = f"cannot be opened: {reason(problem)}"
        raise DatasetError(path, message, "replace the file") from None


# --- as a labelled set ------------------------------------------------------------------


@dataclass(frozen=True)
class CorrectionLabels:
    """The truth in the log of a picture, which is the item's label."""

    def truth(self, item: LabelledItem) -> Truth:
        """Read what was said; DatasetError for a log that cannot be read."""
        log = read_log(item.label)
        if log is None:
            raise DatasetError(item.label, "holds no corrections", "correct the picture again")
        road, layout = road_layer(log.labels), layout_layer(log.labels)
        return Truth(
            torch.from_numpy(road == ROAD_SAID),
            torch.from_numpy((road == ROAD_SAID) | (road == NOT_ROAD)),
            torch.from_numpy(layout) if (layout != UNLABELLED).any() else None,
        )


def open_corrections(folder: Path, pictures: Path | None = None) -> Dataset:
    """The corrected pictures of which the road of some pixel was said, in the order of their names.

    folder, pictures: see ``read_corrections``, which says what is raised; DatasetError too where
    nobody said anything of the road.
    """
    items = []
    for correction in read_corrections(folder, pictures):
        if correction.says_road.any():
            name = PurePosixPath(correction.name).with_suffix("").as_posix()
            items.append(LabelledItem(name, correction.picture, correction.log))
    if not items:
        raise DatasetError(folder, "says nothing of the road", "correct some pictures")
    return Dataset("corrections", folder, "all", tuple(items), CorrectionLabels())
