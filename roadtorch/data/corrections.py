"""Corrections by people: what was said about each picture, by whom, in what time.

``read_corrections`` is what training and reports start from. Nobody's stroke is lost where people
disagree: each has a log, and a pixel on which they contradict each other is void.
"""

import os
from collections import defaultdict
from collections.abc import Sequence
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
    OPEN,
    ROAD_SAID,
    VOID_SAID,
    labels_of,
    layout_layer,
    road_layer,
)
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.data.events import ENDING, EventLog, click_count, read_log, read_logs
from roadtorch.layout.classes import UNLABELLED

TURNED = (5, 6, 7, 8)  # EXIF orientations that swap width and height


@dataclass(frozen=True, eq=False)
class Correction:
    """What people said about one picture.

    picture: its file. name: relative to the folder of pictures, with ending. labels: uint8 (H,W),
    numbers of ``LABELS``. confirmed: somebody said that it is right as it is, so that every
    pixel's road is known. users: sorted. seconds: at work on it, of all of them. clicks: strokes of
    all of them, those taken back among them. agreement: share of the pixels that two or more
    spoke of on which all of them agree about the road; None where there are none. logs:
    where it was said.
    """

    picture: Path
    name: str
    labels: np.ndarray
    confirmed: bool
    users: tuple[str, ...]
    seconds: float
    clicks: int
    agreement: float | None = None
    logs: tuple[Path, ...] = ()

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
    """What is known of each picture that was worked on, sorted by name.

    folder: where ``roadtorch annotate`` keeps its logs. pictures: their folder, if it moved;
    else the logs know. Pictures on which every stroke was taken back are left out. Raises
    DatasetError for a folder without logs, and for a broken one.
    """
    by_picture: dict[str, list[EventLog]] = defaultdict(list)
    for log in read_logs(folder):
        ending = f".{log.head.user}{ENDING}"
        by_picture[log.path.relative_to(folder).as_posix().removesuffix(ending)].append(log)
    if not by_picture:
        raise DatasetError(folder, "holds no corrections", "make some with roadtorch annotate")
    corrections = []
    for name, logs in sorted(by_picture.items()):
        logged = Path(os.path.normpath(folder / logs[0].head.picture))
        corrections.append(corrected(pictures / name if pictures else logged, name, logs))
    return [correction for correction in corrections if (correction.labels > 0).any()]


def corrected(picture: Path, name: str, logs: Sequence[EventLog]) -> Correction:
    """What one or more logs of a picture come to.

    Raises DatasetError where two are for pictures of different sizes or events do not fit theirs.
    """
    if len({log.size for log in logs}) > 1:
        message = f"is for another picture size than {logs[0].path.name}"
        raise DatasetError(logs[-1].path, message, "correct one version of the picture")
    labels = [log.labels for log in logs]
    events = [event for log in logs for event in log.events]
    return Correction(
        picture,
        name,
        agreed_labels(labels),
        any(log.confirmed for log in logs),
        tuple(sorted(log.head.user for log in logs)),
        sum(event.seconds for event in events),
        click_count(events),
        agreement_share(labels),
        tuple(log.path for log in logs),
    )


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


# --- several people ---------------------------------------------------------------------


def agreed_labels(people: Sequence[np.ndarray]) -> np.ndarray:
    """Labels uint8 (H,W) of several people's: void where those who spoke contradict each other.

    Ours: training is better without a pixel than with a wrong one.
    """
    if len(people) == 1:
        return people[0]
    road = _agreed([road_layer(labels) for labels in people], VOID_SAID)
    layout = _agreed([layout_layer(labels) for labels in people], UNLABELLED)
    return labels_of(road, layout)


def _agreed(layers: Sequence[np.ndarray], contradiction: int) -> np.ndarray:
    """What all say who say anything, uint8 (H,W); in layers and where nobody does it is 255."""
    stack = np.stack(layers)
    low, high = stack.min(0), np.where(stack == OPEN, 0, stack).max(0)
    return np.where((low == high) | (low == OPEN), low, contradiction)


def agreement_share(people: Sequence[np.ndarray]) -> float | None:
    """Share of the pixels that two or more spoke of on which all say the same of the road."""
    layers = [road_layer(labels) for labels in people]
    several = sum(layer != OPEN for layer in layers) > np.uint8(1)
    return float((_agreed(layers, OPEN) != OPEN)[several].mean()) if several.any() else None


# --- as a labelled set ------------------------------------------------------------------


@dataclass(frozen=True)
class CorrectionLabels:
    """The truth in the logs of a picture: the item's label, and those of further people."""

    def truth(self, item: LabelledItem) -> Truth:
        """What people said; DatasetError for a log that cannot be read."""
        logs = [log for path in (item.label, *item.extra) if (log := read_log(path)) is not None]
        correction = corrected(item.image, item.name, logs)
        layout = torch.from_numpy(correction.layout)
        return Truth(
            torch.from_numpy(correction.road == ROAD_SAID),
            torch.from_numpy(correction.says_road),
            layout if (layout != UNLABELLED).any() else None,
        )


def open_corrections(folder: Path, pictures: Path | None = None) -> Dataset:
    """The corrected pictures of which the road of some pixel was said, in the order of their names.

    folder, pictures: see ``read_corrections``, which says what is raised; DatasetError too where
    nobody said anything of the road.
    """
    items = []
    for correction in read_corrections(folder, pictures):
        if correction.says_road.any():
            name, logs = PurePosixPath(correction.name).with_suffix("").as_posix(), correction.logs
            items.append(LabelledItem(name, correction.picture, logs[0], None, logs[1:]))
    if not items:
        raise DatasetError(folder, "says nothing of the road", "correct some pictures")
    return Dataset("corrections", folder, "all", tuple(items), CorrectionLabels())
