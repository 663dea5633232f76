"""A session of corrections: a folder of images, the machine's views, and the work on them."""

import hashlib
import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from roadtorch.annotate.machine import (
    VIEWS,
    AnnotationSettings,
    ImageView,
    ViewStore,
    at_size,
    mended_layout,
    mended_odds,
    said_of_segments,
    shown_road,
)
from roadtorch.annotate.next_images import ImageOrder
from roadtorch.base.atomic import remove_leftovers
from roadtorch.base.bounded import printable
from roadtorch.base.errors import InputError
from roadtorch.data.correction_formats import FORMATS
from roadtorch.data.corrections import (
    ENDING,
    EventLog,
    LogHead,
    image_size,
    log_path,
    read_log,
    read_logs,
)
from roadtorch.data.events import (
    LABELS,
    AnyEvent,
    Confirm,
    Import,
    SuperpixelStroke,
    click_count,
    redoable,
    runs_of,
)
from roadtorch.detectors.detector import Detector
from roadtorch.inputs.images import find_images

HELD = 8  # logs in memory, with their labels

FRESH = 2.0  # seconds for which a listing holds

# --- what there is to correct -----------------------------------------------------------


@dataclass
class ImageFolder:
    """The images below ``root``, by their relative name with ending; ``apart`` is left out."""

    root: Path
    apart: Path
    _names: tuple[str, ...] = ()
    _listed: float = field(default=-FRESH, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __post_init__(self) -> None:
        self.root, self.apart = self.root.resolve(), self.apart.resolve()

    def names(self) -> tuple[str, ...]:
        """What is there now, sorted; looked up anew after ``FRESH`` seconds."""
        with self._lock:
            if time.monotonic() - self._listed >= FRESH:
                try:
                    paths = [image.path for image in find_images([self.root], self.apart)]
                except InputError:  # emptied while the page is open
                    paths = []
                inside = [path for path in paths if path.resolve().is_relative_to(self.root)]
                names = [path.relative_to(self.root).as_posix() for path in inside]
                self._names = tuple(name for name in names if name == printable(name))
                self._listed = time.monotonic()
            return self._names

    def path(self, name: str) -> Path:
        """Return the file of a name that came from outside.

        Raises InputError for one that is not in ``names``, letter by letter, one that is gone, and
        one that leads out of the folder by now.
        """
        path = self.root / name
        if name in self.names() and path.is_file() and path.resolve().is_relative_to(self.root):
            return path
        raise InputError(name[:200], "is no image of this folder", "choose one of the list")


def open_work(images: ImageFolder, out: Path, name: str, size: tuple[int, int]) -> EventLog:
    """Open the log for an image of (height, width), or begin one.

    Raises DatasetError for a log that cannot be read or does not fit its image.
    """
    path = log_path(out, name)
    log = read_log(path) if path.exists() else None
    if log is None:
        image = os.path.relpath(images.root / name, images.apart)
        log = EventLog(path, LogHead(image=image, height=size[0], width=size[1]))
    log.labels  # noqa: B018  # refused now where an event does not fit
    return log


# --- the session ------------------------------------------------------------------------


@dataclass
class Session:
    """What the page asks for. images: their folder; views: the machine's; out: the logs.

    order: in which images are offered.
    """

    images: ImageFolder
    views: ViewStore
    out: Path
    order: ImageOrder
    trusts: dict[str, float] = field(default_factory=dict)
    _works: dict[str, EventLog] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)
    _summaries: dict[Path, tuple[int, dict[str, Any] | None]] = field(
        default_factory=dict, repr=False
    )

    # --- what there is ------------------------------------------------------------------

    def listing(self) -> list[dict[str, Any]]:
        """List every image: its name, trust and turn if known, its events and verdict."""
        work, names = self._work_by_image(), self.images.names()
        untouched = {"events": 0, "confirmed": False, "version": 0}
        turns = self.order.turns(names, self.trusts, work)
        return [
            {
                "name": name,
                "trust": self._trust(name),
                "turn": turns.get(name),
                **work.get(name, untouched),
            }
            for name in names
        ]

    def _trust(self, name: str) -> float | None:
        trust = self.trusts.get(name)
        return None if trust is None or np.isnan(trust) else round(trust, 3)

    def _work_by_image(self) -> dict[str, dict[str, Any]]:
        """Summarise the work on each image; a log is read again when its length changed."""
        work: dict[str, dict[str, Any]] = {}
        for path in sorted(self.out.rglob(f"*{ENDING}")):
            name = path.relative_to(self.out).as_posix().removesuffix(ENDING)
            length, (known, summary) = path.stat().st_size, self._summaries.get(path, (-1, None))
            if known != length:
                log = read_log(path)
                summary = None
                if log and log.events:
                    summary = {
                        "events": len(log.effective_events),
                        "confirmed": log.confirmed,
                        "version": len(log.events),
                    }
                self._summaries[path] = length, summary
            if summary:
                work[name] = summary
        return work

    # --- one image --------------------------------------------------------------------

    def view(self, name: str) -> ImageView:
        """Return the machine's view of an image; InputError where it is none of the folder."""
        view = self.views.view(name, self.images.path(name))
        self.trusts[name] = np.nan if view.trust is None else view.trust
        return view

    def state(self, name: str) -> dict[str, Any]:
        """Return an image as the page shows it."""
        view = self.view(name)
        with self._lock:
            return self._shown(name, self._work(name, view), view)

    def add(self, name: str, event: AnyEvent) -> dict[str, Any]:
        """Take an event, have it on disk, infer the rest anew, and return the state."""
        view = self.view(name)
        with self._lock:
            work = self._work(name, view)
            work.add(self._completed(event, work, view))
            return self._shown(name, work, view)

    def _work(self, name: str, view: ImageView) -> EventLog:
        """Return the log of an image, read anew unless it is among the last ``HELD``."""
        work = self._works.pop(name, None)
        if work is None:
            work = open_work(self.images, self.out, name, view.size)
        if work.size != view.size:
            message = f"was corrected at {work.head.width} by {work.head.height} pixels"
            hint = f"it has another size now; move {work.path.name} away"
            raise InputError(name, message, hint)
        self._works[name] = work
        if len(self._works) > HELD:
            del self._works[next(iter(self._works))]
        return work

    def _completed(self, event: AnyEvent, work: EventLog, view: ImageView) -> AnyEvent:
        """The event with its time and with the pixels that it is about."""
        changes: dict[str, Any] = {"time": round(time.time(), 3)}
        if isinstance(event, SuperpixelStroke):
            count = len(view.segment_odds)
            if any(number >= count for number in event.segments):
                message = f"has {count} superpixels, and one of a higher number was clicked"
                raise InputError(work.path.name, message, "load the page again")
            chosen = np.isin(view.labels.numpy(), event.segments)
            changes["runs"] = runs_of(at_size(chosen, view.size))
        if isinstance(event, Confirm):
            changes["runs"] = runs_of(shown_road(self._odds(work, view), work.labels, view.size))
        return event.model_copy(update=changes)

    def _odds(self, work: EventLog, view: ImageView) -> Any:
        settings = self.views.settings
        said = said_of_segments(work.labels, view, settings)
        return mended_odds(view, said, settings.propagation)

    def _shown(self, name: str, work: EventLog, view: ImageView) -> dict[str, Any]:
        road = shown_road(self._odds(work, view), work.labels, view.shape)
        layout = np.minimum(mended_layout(view, work.labels, self.views.settings), 3)
        layers = at_size(work.labels, view.shape) | road.astype(np.uint8) << 3 | layout << 4
        return {
            "name": name,
            "size": [view.size[1], view.size[0]],
            "shape": [view.shape[1], view.shape[0]],
            "trust": self._trust(name),
            "version": len(work.events),
            "events": [event.id for event in work.effective_events],
            "redo": redoable(work.events),
            "confirmed": work.confirmed,
            "seconds": round(work.seconds, 1),
            "clicks": click_count(work.events),
            "layers": layers.astype(np.uint8).tobytes(),
        }


def look_at_all(session: Session, stop: threading.Event) -> None:
    """Look at every image, one after the other, until told to stop; new ones as they come."""
    failed: set[str] = set()
    while not stop.is_set():
        for name in session.images.names():
            if stop.is_set():
                return
            if name in session.trusts or name in failed:
                continue
            try:
                path = session.images.path(name)
                session.order.learn(name, path, session.view(name))
            except (InputError, OSError):
                failed.add(name)
        stop.wait(2)


def opened_session(
    folder: Path,
    out: Path,
    detector: Detector,
    order: ImageOrder | None = None,
) -> Session:
    """A session for a folder; DatasetError where a log in ``out`` cannot be read.

    What killed ones left half-written is removed, so no other may be at work there.
    """
    read_logs(out)
    remove_leftovers(Path(below) for below, _, _ in os.walk(out / VIEWS))
    views = ViewStore(out / VIEWS, detector, AnnotationSettings())
    order = order or ImageOrder("least-trust")
    return Session(ImageFolder(folder, out), views, out, order)


# --- labels of other programs -----------------------------------------------------------


def import_labels(name: str, origin: Path, folder: Path, out: Path) -> int:
    """Add the labels of a format in ``origin`` to the logs; return how many images had some.

    Raises DatasetError for what cannot be read; then nothing was added.
    """
    images = ImageFolder(folder, out)
    sizes = {image: image_size(images.path(image)) for image in images.names()}
    by_image = FORMATS[name].read(origin, sizes)
    for image, labels in by_image.items():
        work = open_work(images, out, image, sizes[image])
        if not work.events or (work.labels != labels).any():  # else they were brought in before
            work.add(import_event(labels, len(work.events)))
    return len(by_image)


def import_event(labels: np.ndarray, number: int = 0) -> Import:
    """The event of a number that makes labels uint8 (H,W) what they are here."""
    runs = {LABELS[label]: runs_of(labels == label) for label in np.unique(labels).tolist()}
    identity = hashlib.sha256(f"{number} {runs}".encode()).hexdigest()[:32]
    return Import(kind="brought", id=identity, time=round(time.time(), 3), labels=runs)
