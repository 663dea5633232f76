"""A session of corrections: a folder of pictures, the machine's views, and everybody's work."""

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from roadtorch.annotate.machine import (
    AnnotationSettings,
    PictureView,
    at_size,
    mended_layout,
    mended_odds,
    said_of_segments,
    seen_as,
    shown_road,
)
from roadtorch.annotate.next_pictures import PictureOrder
from roadtorch.annotate.review import RUN, check_reviewer, confirmation, hasty_runs
from roadtorch.annotate.views import ViewStore
from roadtorch.annotate.work import PictureFolder, open_work
from roadtorch.data.correction_labels import LABELS
from roadtorch.data.corrections import agreement_share
from roadtorch.data.event_log import ENDING, EventLog, log_path, read_log
from roadtorch.data.events import (
    AnyEvent,
    Confirm,
    Copy,
    SuperpixelStroke,
    mask_of,
    reviewers,
    runs_of,
    taken_back,
)
from roadtorch.errors import InputError

HELD = 2**26  # bytes of labels in memory, and one picture's in any case


@dataclass
class Session:
    """What the page asks for. pictures: their folder; views: the machine's; out: the logs.

    order: in which pictures are offered; None for the least trust first.
    """

    pictures: PictureFolder
    views: ViewStore
    out: Path
    settings: AnnotationSettings
    trusts: dict[str, float] = field(default_factory=dict)
    order: PictureOrder | None = None
    _works: WeakValueDictionary[tuple[str, str], EventLog] = field(
        default_factory=WeakValueDictionary, repr=False
    )
    _held: list[EventLog] = field(default_factory=list, repr=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False)
    _summaries: dict[Path, tuple[int, Any]] = field(default_factory=dict, repr=False)

    # --- what there is ------------------------------------------------------------------

    def listing(self) -> list[dict[str, Any]]:
        """Every picture: its name, trust and turn if known, each person's events and verdict."""
        work, names = self._work_by_picture(), self.pictures.names()
        turns = self.order.turns(names, self.trusts, work) if self.order else {}
        return [
            {
                "name": name,
                "trust": self._trust(name),
                "turn": turns.get(name),
                "users": {
                    user: {key: value for key, value in one.items() if key != "took"}
                    for user, one in work.get(name, {}).items()
                },
            }
            for name in names
        ]

    def hasty(self) -> dict[str, int]:
        """Who called so many pictures in a row right, up to now, that nobody looks so fast."""
        work = self._work_by_picture().values()
        took = ((user, one["took"]) for users in work for user, one in users.items())
        return {user: runs[-1] for user, runs in hasty_runs(took).items() if runs[-1] >= RUN}

    def _trust(self, name: str) -> float | None:
        trust = self.trusts.get(name)
        return None if trust is None or np.isnan(trust) else round(trust, 3)

    def _work_by_picture(self) -> dict[str, dict[str, dict[str, Any]]]:
        """What each person did on each picture; a log is read again when its length changed."""
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for path in sorted(self.out.rglob(f"*{ENDING}")):
            stem = path.relative_to(self.out).as_posix().removesuffix(ENDING)
            name, _, user = stem.rpartition(".")
            length, (known, summary) = path.stat().st_size, self._summaries.get(path, (-1, None))
            if known != length:
                log = read_log(path)
                summary = log and {
                    "events": len(log.standing),
                    "confirmed": log.confirmed,
                    "version": len(log.events),
                    "reviewed": list(reviewers(log.standing)),
                    "took": confirmation(log),
                }
                self._summaries[path] = length, summary
            if summary and summary["version"]:
                found.setdefault(name, {})[user] = summary
        return found

    # --- one picture --------------------------------------------------------------------

    def view(self, name: str) -> PictureView:
        """The machine's view of a picture; InputError where it is none, or gone."""
        view = self.views.view(name, self.pictures.path(name))
        self.trusts[name] = np.nan if view.trust is None else view.trust
        return view

    def _view_or_last(self, name: str) -> PictureView:
        """The view of a picture even if its file was deleted while it was being corrected."""
        try:
            return self.view(name)
        except InputError:
            if (view := self.views.last_view(name)) is None:
                raise
            return view

    def _work(self, name: str, user: str, view: PictureView) -> EventLog:
        with self._lock:
            if (work := self._works.get((name, user))) is None:
                work = open_work(self.pictures, self.out, name, user, view.size)
                self._works[name, user] = work
            self._held = [*(one for one in self._held if one is not work), work]
            while len(self._held) > 1 and sum(one.labels.nbytes for one in self._held) > HELD:
                del self._held[0]
        if work.size != view.size:
            what = f"was corrected at {work.head.width} by {work.head.height} pixels"
            remedy = f"it has another size now; move {work.path.name} away"
            raise InputError(name, what, remedy)
        return work

    def state(self, name: str, user: str) -> dict[str, Any]:
        """A person's picture as the page shows it; see docs/annotate.md for the fields."""
        view = self._view_or_last(name)
        return self._shown(name, self._work(name, user, view), view)

    def add(self, name: str, user: str, event: AnyEvent) -> dict[str, Any]:
        """Take an event, have it on disk, infer the rest anew, and tell the state."""
        start = time.perf_counter()
        view = self._view_or_last(name)
        work = self._work(name, user, view)
        check_reviewer(user, event, work.events)
        work.add(self._completed(event, name, work, view))
        return {
            **self._shown(name, work, view),
            "milliseconds": 1000 * (time.perf_counter() - start),
        }

    def _completed(self, event: AnyEvent, name: str, work: EventLog, view: PictureView) -> AnyEvent:
        """The event with its time and with the pixels that it is about."""
        changes: dict[str, Any] = {"time": round(time.time(), 3)}
        if isinstance(event, SuperpixelStroke):
            count = len(view.segment_odds)
            if any(number >= count for number in event.segments):
                what = f"has {count} superpixels, and one of a higher number was clicked"
                raise InputError(work.path.name, what, "load the page again")
            chosen = np.isin(view.labels.numpy(), event.segments)
            changes["runs"] = runs_of(at_size(chosen, view.size))
        if isinstance(event, Copy):
            picture, road = self._road_before(name, work)
            changes |= {"picture": picture, "runs": runs_of(road)}
        if isinstance(event, Confirm):
            changes["runs"] = runs_of(shown_road(self._odds(work, view), work.labels, view.size))
        return event.model_copy(update=changes)

    def _road_before(self, own: str, work: EventLog) -> tuple[str, np.ndarray]:
        """The last picture before this one that the person called right, and its road (H,W)."""
        user, done, names = work.head.user, self._work_by_picture(), self.pictures.names()
        for name in reversed(names[: names.index(own)] if own in names else ()):
            if done.get(name, {}).get(user, {}).get("confirmed"):
                log = read_log(log_path(self.out, name, user))
                if log is not None and log.size == work.size:
                    return name, log.labels == LABELS.index("road")
        what = "has no picture of its size before it that you called right"
        raise InputError(own, what, "call the frame before it right first")

    def _odds(self, work: EventLog, view: PictureView) -> Any:
        copied = [one for one in work.standing if isinstance(one, Copy)]
        if copied:
            view = seen_as(view, mask_of(copied[-1].runs, view.size))
        said = said_of_segments(work.labels, view, self.settings)
        return mended_odds(view, said, self.settings.propagation)

    def _shown(self, name: str, work: EventLog, view: PictureView) -> dict[str, Any]:
        shape = (view.labels.shape[0], view.labels.shape[1])
        road = shown_road(self._odds(work, view), work.labels, shape)
        layout = np.minimum(mended_layout(view, work.labels, self.settings), 3)
        layers = at_size(work.labels, shape) | road.astype(np.uint8) << 3 | layout << 4
        return {
            "name": name,
            "size": [view.size[1], view.size[0]],
            "shape": [shape[1], shape[0]],
            "trust": self._trust(name),
            "version": len(work.events),
            "events": [[one.id, one.kind, getattr(one, "saying", "")] for one in work.standing],
            "redo": taken_back(work.events),
            "confirmed": work.confirmed,
            "reviewed": list(reviewers(work.standing)),
            "seconds": round(sum(event.seconds for event in work.events), 1),
            "clicks": len(work.events),
            "agreement": self.agreement(name),
            "layers": layers.astype(np.uint8).tobytes(),
        }

    def agreement(self, name: str) -> float | None:
        """Share of the pixels that two people spoke of on which they agree; None without two."""
        users = sorted(self._work_by_picture().get(name, {}))
        if len(users) < 2:
            return None
        said = []
        for user in users:
            if (work := self._works.get((name, user))) is not None:
                said.append(work.labels)
            elif (log := read_log(log_path(self.out, name, user))) is not None:
                said.append(log.labels)
        return agreement_share(said)


def look_at_all(session: Session, stop: threading.Event) -> None:
    """Look at every picture, one after the other, until told to stop; new ones as they come."""
    failed: set[str] = set()
    while not stop.is_set():
        for name in session.pictures.names():
            if stop.is_set():
                return
            if name in session.trusts or name in failed:
                continue
            try:
                path = session.pictures.path(name)
                if session.order is not None:
                    session.order.learn(name, path, session.view(name))
                if (trust := session.views.trust(name, path)) is None:
                    session.view(name)  # which keeps the trust
                else:
                    session.trusts[name] = trust
            except (InputError, OSError):
                failed.add(name)
        stop.wait(2)
