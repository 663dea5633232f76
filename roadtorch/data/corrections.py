"""Human corrections: a log of events for each image, and the labels that they result in.

A log is DIR/IMAGE.strokes.jsonl, IMAGE with its extension and its sub-folders. Its first line
names the image; then follows a line for each event, only ever appended. A line is on disk (fsync)
before its event is acknowledged. A file without a complete first line, after a crash or on a full
disk, counts as no log: the next event starts it anew.
"""

import os
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import FileIO
from pathlib import Path, PurePosixPath
from typing import Annotated, Protocol, Self

import numpy as np
import torch
from pydantic import Field, model_validator

from roadtorch.base.atomic import file_digest, make_folder, write_error
from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.decoding import check_pixels, open_image, suppress_warnings, upright_size
from roadtorch.base.documents import Side, read_document
from roadtorch.base.errors import DatasetError, InputError
from roadtorch.base.settings import Settings
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.data.events import (
    NOT_ROAD,
    ROAD_LABEL,
    AnyEvent,
    Confirm,
    Redo,
    Undo,
    apply_event,
    count_clicks,
    effective_events,
    layout_layer,
    parse_event,
    replay,
    road_layer,
)
from roadtorch.layout.classes import UNLABELLED

LOG_SUFFIX = ".strokes.jsonl"

# --- logs -------------------------------------------------------------------------------


class LogHeader(Settings):
    """First line of a log; image: path relative to the folder of all logs."""

    roadtorch: int = Field(default=1, ge=1, le=1, description="version of the format")
    image: Annotated[str, Field(pattern=r"^[^\x00]+$")]
    sha256: str = Field(default="", description="of the image's file")
    height: Side
    width: Side

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        check_pixels(self.width, self.height)
        return self


@dataclass(eq=False)
class EventLog:
    """Log of the corrections of one image, for one thread at a time; head: its first line."""

    path: Path
    header: LogHeader
    events: list[AnyEvent] = field(default_factory=list)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the image."""
        return self.header.height, self.header.width

    @property
    def confirmed(self) -> bool:
        """True if the remaining labels were confirmed as shown."""
        return any(isinstance(event, Confirm) for event in effective_events(self.events))

    @property
    def seconds(self) -> float:
        """Working time on the image."""
        return sum(event.seconds for event in self.events)

    @cached_property
    def labels(self) -> np.ndarray:
        """Resulting labels, uint8 (H, W); DatasetError where an event does not fit the image."""
        try:
            return replay(self.events, self.size)
        except InputError as error:
            message = f"has an event that does not fit: {error.where} {error.problem}"
            raise DatasetError(self.path, message, "give the image that was corrected") from None

    def add(self, event: AnyEvent) -> None:
        """Append an event and sync it to disk; an event that the log has already is ignored.

        Raises InputError for one that does not fit the image, UnwritableError for a full disk.
        """
        if any(event.id == previous.id for previous in self.events):
            return
        if isinstance(event, Undo | Redo):
            labels = replay([*self.events, event], self.size)
        else:
            labels = self.labels.copy()
            apply_event(labels, event)
        self._append(event)
        self.events.append(event)
        self.labels = labels

    def _append(self, event: AnyEvent) -> None:
        """Append an event to the file, after the header in a new one, and sync it to disk.

        Raises UnwritableError when it cannot; the file then holds what it held before.
        """
        make_folder(self.path.parent, "give a folder that you may write to with --out")
        try:
            with self.path.open("ab+", buffering=0) as file:
                size = _truncate_partial_line(file)
                head = [] if size else [self.header.model_dump_json()]
                try:
                    lines = memoryview("\n".join([*head, event.model_dump_json(), ""]).encode())
                    while lines:
                        lines = lines[file.write(lines) :]
                    os.fsync(file.fileno())
                    if not size:
                        _sync_folder(self.path.parent)
                except OSError:
                    with suppress(OSError):
                        file.truncate(size)
                    raise
        except OSError as error:
            raise write_error(self.path, error) from None


def _truncate_partial_line(file: FileIO) -> int:
    """Truncate an incomplete last line that a crash left; return the remaining size in bytes."""
    size = file.seek(0, os.SEEK_END)
    if size:
        file.seek(size - 1)
        if file.read(1) != b"\n":
            file.seek(0)
            size = file.readall().rfind(b"\n") + 1
            file.truncate(size)
    return size


def _sync_folder(folder: Path) -> None:
    """Sync a new file's directory entry to disk, where the system can."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def log_path(folder: Path, image: str) -> Path:
    """Return the path of the log of an image, given by its relative name with extension."""
    return folder / f"{PurePosixPath(image)}{LOG_SUFFIX}"


def read_log(path: Path) -> EventLog | None:
    """Read a log without an incomplete last line; None if the first line is incomplete.

    Raises DatasetError naming file and line for any other error.
    """
    with read_document(path, "give logs that roadtorch wrote") as data:
        lines = data[: data.rfind(b"\n") + 1].splitlines()
        if not lines:
            return None
        head = LogHeader.model_validate_json(lines[0])
    try:
        events = [parse_event(line, f"{path}:{at}") for at, line in enumerate(lines[1:], 2)]
    except InputError as error:
        raise DatasetError(error.where, error.problem, "fix or remove that line") from None
    return EventLog(path, head, events)


def read_logs(folder: Path) -> list[EventLog]:
    """Read all logs below a folder, sorted; DatasetError for a missing folder or a broken log."""
    if not folder.is_dir():
        raise DatasetError(folder, "is not a folder", "give the folder with corrections")
    paths = sorted(path for path in folder.rglob(f"*{LOG_SUFFIX}") if path.is_file())
    return [log for path in paths if (log := read_log(path)) is not None]


# --- corrections ------------------------------------------------------------------------


class HumanLabels(Protocol):
    """Human labels of one image."""

    @property
    def image(self) -> Path:
        """File of the image."""
        ...

    @property
    def labels(self) -> np.ndarray:
        """Indices in ``LABEL_NAMES``, uint8, shape (H, W)."""
        ...


def labels_to_truth(labels: np.ndarray) -> Truth:
    """Return indices in ``LABEL_NAMES``, uint8 (H, W), as ground truth."""
    road, layout = road_layer(labels), layout_layer(labels)
    return Truth(
        torch.from_numpy(road == ROAD_LABEL),
        torch.from_numpy((road == ROAD_LABEL) | (road == NOT_ROAD)),
        torch.from_numpy(layout) if (layout != UNLABELLED).any() else None,
    )


@dataclass(frozen=True, eq=False)
class Correction:
    """Human labels of one image.

    Attributes:
        image: its file.
        name: path relative to the folder of images, with extension.
        labels: indices in ``LABEL_NAMES``, uint8, shape (H, W).
        confirmed: true if the rest was confirmed as shown, so that road is known in all pixels.
        seconds: working time.
        clicks: number of strokes, including undone ones.
        log: file of the log.
    """

    image: Path
    name: str
    labels: np.ndarray
    confirmed: bool
    seconds: float
    clicks: int
    log: Path


def read_corrections(folder: Path, images: Path | None = None) -> list[Correction]:
    """Read the corrections of each image, sorted by name, without those that were undone entirely.

    Args:
        folder: where ``roadtorch annotate`` keeps its logs.
        images: folder of the images, if it moved; by default the logs' own paths are used.

    Raises:
        DatasetError: for a folder without logs, and for a broken log.
    """
    logs = read_logs(folder)
    if not logs:
        raise DatasetError(folder, "holds no corrections", "make some with roadtorch annotate")
    corrections = []
    for log in logs:
        name = log.path.relative_to(folder).as_posix().removesuffix(LOG_SUFFIX)
        logged = Path(os.path.normpath(folder / log.header.image))
        image, clicks = images / name if images else logged, count_clicks(log.events)
        if log.header.sha256 and file_digest(image) not in ("", log.header.sha256):
            warnings.warn(f"{image}: is not the image that was corrected", stacklevel=2)
        entry = Correction(image, name, log.labels, log.confirmed, log.seconds, clicks, log.path)
        corrections.append(entry)
    corrections.sort(key=lambda correction: correction.name)
    return [correction for correction in corrections if (correction.labels > 0).any()]


def read_image_size(path: Path) -> tuple[int, int]:
    """Read (height, width) of an image from its header, after EXIF rotation; DatasetError else."""
    try:
        with open_image(read_regular(path)) as image, suppress_warnings():
            return upright_size(image)
    except Exception as error:
        raise DatasetError(path, f"cannot be opened: {reason(error)}", "replace the file") from None


# --- as a labelled set ------------------------------------------------------------------


@dataclass(frozen=True)
class CorrectionLabels:
    """Reader of ground truth from an image's log, which is the item's label file."""

    def truth(self, item: LabelledItem) -> Truth:
        """Read the log; DatasetError when it cannot be read."""
        log = read_log(item.label)
        if log is None:
            raise DatasetError(item.label, "holds no corrections", "correct the image again")
        return labels_to_truth(log.labels)


def open_corrections(folder: Path, split: str = "all") -> Dataset:
    """Open the corrected images with road labels as a data set, sorted by name.

    Raises:
        DatasetError: as ``read_corrections`` does, and when no pixel has a road label.
    """
    items = []
    for correction in read_corrections(folder):
        if labels_to_truth(correction.labels).valid.any():
            name = PurePosixPath(correction.name).with_suffix("").as_posix()
            items.append(LabelledItem(name, correction.image, correction.log))
    if not items:
        raise DatasetError(folder, "has no road labels", "correct some images")
    return Dataset("corrections", folder, split, tuple(items), CorrectionLabels())
