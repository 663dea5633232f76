"""A session of the correction page: images, the detector's views of them, and event logs."""

import hashlib
import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from roadtorch.annotate.views import (
    VIEWS_FOLDER,
    ImageView,
    ViewStore,
    corrected_layout,
    corrected_log_odds,
    corrected_road,
    resize_labels,
)
from roadtorch.base.atomic import file_digest, remove_leftovers
from roadtorch.base.bounded import to_printable
from roadtorch.base.errors import InputError
from roadtorch.data.correction_formats import CORRECTION_FORMATS
from roadtorch.data.corrections import (
    LOG_SUFFIX,
    EventLog,
    LogHeader,
    log_path,
    read_image_size,
    read_log,
    read_logs,
)
from roadtorch.data.events import (
    LABEL_NAMES,
    AnyEvent,
    Confirm,
    Import,
    SuperpixelStroke,
    count_clicks,
    effective_events,
    redoable_ids,
)
from roadtorch.data.polygons import encode_counts
from roadtorch.detectors.detector import Detector
from roadtorch.inputs.images import find_images

MAX_LOGS = 8  # in memory, with their labels
LISTING_SECONDS = 2.0  # for which a listing of the folder is cached
Summary = dict[str, int | bool]  # of a log: its events and version, and whether confirmed

# --- images and logs --------------------------------------------------------------------


@dataclass
class ImageFolder:
    """The images below ``root`` except those below ``out``, by relative path with suffix."""

    root: Path
    out: Path
    _names: tuple[str, ...] = ()
    _listed: float = field(default=-LISTING_SECONDS, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __post_init__(self) -> None:
        self.root, self.out = self.root.resolve(), self.out.resolve()

    def names(self) -> tuple[str, ...]:
        """List the images, sorted; the listing is cached for ``LISTING_SECONDS``."""
        with self._lock:
            if time.monotonic() - self._listed >= LISTING_SECONDS:
                try:
                    paths = [image.path for image in find_images([self.root], self.out)]
                except InputError:  # emptied while the page is open
                    paths = []
                inside = [path for path in paths if path.resolve().is_relative_to(self.root)]
                names = [path.relative_to(self.root).as_posix() for path in inside]
                self._names = tuple(name for name in names if name == to_printable(name))
                self._listed = time.monotonic()
            return self._names

    def path(self, name: str) -> Path:
        """Return the file of a name from a request.

        Raises InputError for a name that is not exactly one of ``names``, or whose file is missing
        or a link out of the folder.
        """
        path = self.root / name
        if name in self.names() and path.is_file() and path.resolve().is_relative_to(self.root):
            return path
        raise InputError(name[:200], "is not an image of this folder", "choose one of the list")


def open_log(images: ImageFolder, out: Path, name: str, size: tuple[int, int]) -> EventLog:
    """Open or create the log of an image of (height, width); DatasetError if it does not fit.

    Raises InputError where the image is not the one that was corrected.
    """
    path, file = log_path(out, name), images.root / name
    log, digest = read_log(path) if path.exists() else None, file_digest(file)
    if log is None:
        image = os.path.relpath(file, images.out)
        header = LogHeader(image=image, sha256=digest, height=size[0], width=size[1])
        log = EventLog(path, header)
    if log.size != size:
        message = f"was corrected at {log.header.width} by {log.header.height} pixels"
        raise InputError(name, message, f"its size has changed; move {path.name} away")
    if log.header.sha256 not in ("", digest):
        raise InputError(name, "is not the image that was corrected", f"move {path.name} away")
    log.labels  # noqa: B018  # raises where an event does not fit
    return log


# --- the session ------------------------------------------------------------------------


@dataclass(eq=False)
class Session:
    """The state behind the page; views: cache of the detector's views. out: folder of the logs.

    trusts: of the images that have a view; NaN where the detector gives none.
    """

    images: ImageFolder
    views: ViewStore
    out: Path
    trusts: dict[str, float] = field(default_factory=dict)
    _logs: dict[str, tuple[ImageView, EventLog]] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)
    _summaries: dict[Path, tuple[int, Summary | None]] = field(default_factory=dict, repr=False)

    @property
    def key(self) -> str:
        """Key of the two folders: unsent events of a page wait for the session of their key."""
        return hashlib.sha256(f"{self.images.root}\0{self.images.out}".encode()).hexdigest()[:16]

    # --- all images ---------------------------------------------------------------------

    def listing(self) -> list[dict[str, Any]]:
        """List all images with name, trust, numbers of effective and of all events, and state.

        The least trusted come first, then those of unknown trust, confirmed ones last.
        """
        summaries = self._summarise_logs()
        untouched = {"events": 0, "confirmed": False, "version": 0}
        listing = [
            {"name": name, "trust": self._trust(name), **summaries.get(name, untouched)}
            for name in self.images.names()
        ]

        def order(image: dict[str, Any]) -> tuple[bool, float, str]:
            return (
                image["confirmed"],
                2 if image["trust"] is None else image["trust"],
                image["name"],
            )

        return sorted(listing, key=order)

    def _trust(self, name: str) -> float | None:
        trust = self.trusts.get(name)
        return None if trust is None or np.isnan(trust) else round(trust, 3)

    def _summarise_logs(self) -> dict[str, Summary]:
        """Summarise the log of each image; a log is read again when its size has changed."""
        summaries: dict[str, Summary] = {}
        for path in sorted(self.out.rglob(f"*{LOG_SUFFIX}")):
            name = path.relative_to(self.out).as_posix().removesuffix(LOG_SUFFIX)
            length, (cached, summary) = path.stat().st_size, self._summaries.get(path, (-1, None))
            if cached != length:
                log = read_log(path)
                summary = None
                if log and log.events:
                    summary = {
                        "events": len(effective_events(log.events)),
                        "confirmed": log.confirmed,
                        "version": len(log.events),
                    }
                self._summaries[path] = length, summary
            if summary:
                summaries[name] = summary
        return summaries

    # --- one image ----------------------------------------------------------------------

    def view(self, name: str) -> ImageView:
        """Return the detector's view of an image; InputError where it is not in the folder."""
        view = self.views.view(name, self.images.path(name))
        self.trusts[name] = np.nan if view.trust is None else view.trust
        return view

    def state(self, name: str) -> dict[str, Any]:
        """Return the state of an image for the page."""
        view = self.view(name)
        with self._lock:
            return self._page_state(name, self._log(name, view), view)

    def add(self, name: str, event: AnyEvent) -> dict[str, Any]:
        """Append an event to the log on disk, propagate it, and return the new state."""
        view = self.view(name)
        with self._lock:
            log = self._log(name, view)
            log.add(self._complete(event, log, view))
            return self._page_state(name, log, view)

    def _log(self, name: str, view: ImageView) -> EventLog:
        """Return the log of the image of a view; the last ``MAX_LOGS`` are kept in memory."""
        opened, log = self._logs.pop(name, (None, None))
        if log is None or opened is not view:  # the image was replaced, or its view computed again
            log = open_log(self.images, self.out, name, view.size)
        self._logs[name] = view, log
        if len(self._logs) > MAX_LOGS:
            del self._logs[next(iter(self._logs))]
        return log

    def _complete(self, event: AnyEvent, log: EventLog, view: ImageView) -> AnyEvent:
        """Return an event with its time and the pixels that it labels."""
        changes: dict[str, object] = {"time": round(time.time(), 3)}
        if isinstance(event, SuperpixelStroke):
            count = len(view.segment_odds)
            if any(number >= count for number in event.segments):
                message = f"has {count} superpixels, and a higher number was clicked"
                raise InputError(log.path.name, message, "load the page again")
            chosen = np.isin(view.labels.numpy(), event.segments)
            changes["counts"] = encode_counts(resize_labels(chosen, view.size))
        if isinstance(event, Confirm):
            odds = corrected_log_odds(view, log.labels)
            changes["counts"] = encode_counts(corrected_road(odds, log.labels, view.size))
        return event.model_copy(update=changes)

    def _page_state(self, name: str, log: EventLog, view: ImageView) -> dict[str, object]:
        odds = corrected_log_odds(view, log.labels)
        road = corrected_road(odds, log.labels, view.shape)
        layout = np.minimum(corrected_layout(view, log.labels), 3)
        layers = resize_labels(log.labels, view.shape) | road.astype(np.uint8) << 3 | layout << 4
        return {
            "name": name,
            "size": [view.size[1], view.size[0]],
            "shape": [view.shape[1], view.shape[0]],
            "trust": self._trust(name),
            "version": len(log.events),
            "events": [event.id for event in effective_events(log.events)],
            "redo": redoable_ids(log.events),
            "confirmed": log.confirmed,
            "seconds": round(log.seconds, 1),
            "clicks": count_clicks(log.events),
            "layers": layers.astype(np.uint8).tobytes(),
        }


def compute_views(session: Session, stop: threading.Event) -> None:
    """Compute the views of all images, and of new ones, until ``stop`` is set."""
    failed: set[str] = set()
    while not stop.is_set():
        for name in session.images.names():
            if stop.is_set():
                return
            if name in session.trusts or name in failed:
                continue
            try:
                session.view(name)
            except Exception:  # whatever one image does, the others get their views
                failed.add(name)
        stop.wait(2)


def open_session(folder: Path, out: Path, detector: Detector) -> Session:
    """Open a session on a folder; DatasetError where a log in ``out`` cannot be read.

    Removes half-written files of killed sessions, so ``out`` must be locked.
    """
    read_logs(out)
    remove_leftovers(Path(below) for below, _, _ in os.walk(out / VIEWS_FOLDER))
    views = ViewStore(out / VIEWS_FOLDER, detector)
    return Session(ImageFolder(folder, out), views, out)


# --- import -----------------------------------------------------------------------------


def import_labels(name: str, origin: Path, folder: Path, out: Path) -> int:
    """Import labels of a format from ``origin`` into the logs; return the number of images.

    Raises DatasetError where something cannot be read, InputError where an image was replaced; then
    nothing is imported.
    """
    images = ImageFolder(folder, out)
    sizes = {image: read_image_size(images.path(image)) for image in images.names()}
    by_image = CORRECTION_FORMATS[name].read(origin, sizes)
    logs = {image: open_log(images, out, image, sizes[image]) for image in by_image}
    for image, labels in by_image.items():
        log = logs[image]
        if not log.events or (log.labels != labels).any():  # else they are already imported
            log.add(make_import_event(labels, len(log.events)))
    return len(by_image)


def make_import_event(labels: np.ndarray, number: int = 0) -> Import:
    """Return the event that imports labels, uint8 (H, W); number: of earlier events, for its id."""
    counts = {LABEL_NAMES[label]: encode_counts(labels == label) for label in np.unique(labels)}
    identity = hashlib.sha256(f"{number} {counts}".encode()).hexdigest()[:32]
    return Import(kind="import", id=identity, time=round(time.time(), 3), labels=counts)
