"""A session of corrections: a folder of pictures, the machine's views, and everybody's work."""

import os
import re
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from roadtorch.annotate.machine import (
    AnnotationSettings,
    PictureView,
    at_size,
    mended_layout,
    mended_odds,
    said_of_segments,
    shown_road,
)
from roadtorch.annotate.order import PictureOrder
from roadtorch.annotate.pictures import PictureFolder
from roadtorch.annotate.views import ViewStore
from roadtorch.annotate.work import Work, open_work
from roadtorch.data.corrections import agreement_share
from roadtorch.data.journal import ENDING, JournalHead, journal_path
from roadtorch.data.strokes import AnyAct, Right, SuperpixelStroke, runs_of
from roadtorch.errors import InputError

USER = re.compile(r"[A-Za-z0-9_-]{1,32}")

HELD = 24  # works in memory


def checked_user(user: str) -> str:
    """The name of a user, which is part of file names; InputError where it cannot be."""
    if not USER.fullmatch(user):
        what = "is no name for a user"
        raise InputError(user[:40] or "user", what, "use 1 to 32 letters, digits, _ or -")
    return user


@dataclass
class Session:
    """What the page asks for. pictures: their folder; views: the machine's; out: the journals.

    order: in which pictures are offered; None for the least trust first.
    """

    pictures: PictureFolder
    views: ViewStore
    out: Path
    settings: AnnotationSettings
    trusts: dict[str, float] = field(default_factory=dict)
    order: PictureOrder | None = None
    _works: OrderedDict[tuple[str, str], Work] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False)
    _summaries: dict[Path, tuple[int, int, bool, int]] = field(default_factory=dict, repr=False)

    # --- what there is ------------------------------------------------------------------

    def listing(self) -> list[dict[str, Any]]:
        """Every picture: its name, trust and turn if known, each person's acts and verdict."""
        work, names = self._work_by_picture(), self.pictures.names()
        turns = self.order.turns(names, self.trusts, work) if self.order else {}
        return [
            {
                "name": name,
                "trust": self._trust(name),
                "turn": turns.get(name),
                "users": work.get(name, {}),
            }
            for name in names
        ]

    def _trust(self, name: str) -> float | None:
        trust = self.trusts.get(name)
        return None if trust is None or np.isnan(trust) else round(trust, 3)

    def _work_by_picture(self) -> dict[str, dict[str, dict[str, Any]]]:
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for path in sorted(self.out.rglob(f"*{ENDING}")):
            stem = path.relative_to(self.out).as_posix().removesuffix(ENDING)
            name, _, user = stem.rpartition(".")
            if not USER.fullmatch(user):
                continue
            acts, right, version = self._summary(path, name, user)
            if version:
                found.setdefault(name, {})[user] = {
                    "acts": acts,
                    "right": right,
                    "version": version,
                }
        return found

    def _summary(self, path: Path, name: str, user: str) -> tuple[int, bool, int]:
        """Standing acts, verdict and acts of a journal, read again when its length changed."""
        length = path.stat().st_size
        known = self._summaries.get(path)
        if known is None or known[0] != length:
            work = self._work(name, user, None)
            known = length, len(work.standing()), work.confirmed, len(work.acts)
            self._summaries[path] = known
        return known[1:]

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

    def _work(self, name: str, user: str, view: PictureView | None) -> Work:
        checked_user(user)
        with self._lock:
            key = (name, user)
            if key not in self._works:
                path = journal_path(self.out, name, user)
                height, width = view.size if view else (1, 1)
                picture = os.path.relpath(self.pictures.root / name, self.pictures.apart)
                head = JournalHead(picture=picture, user=user, height=height, width=width)
                work = open_work(path, head)
                if view is None and not path.exists():
                    return work
                self._works[key] = work
            self._works.move_to_end(key)
            while len(self._works) > HELD:
                self._works.popitem(last=False)
            work = self._works[key]
            if view is not None and (work.head.height, work.head.width) != view.size:
                what = f"was corrected at {work.head.width} by {work.head.height} pixels"
                remedy = f"it has another size now; move {work.path.name} away"
                raise InputError(name, what, remedy)
            return work

    def state(self, name: str, user: str) -> dict[str, Any]:
        """A person's picture as the page shows it; see docs/annotate.md for the fields."""
        view = self._view_or_last(name)
        return self._state(name, self._work(name, user, view), view)

    def act(self, name: str, user: str, act: AnyAct) -> dict[str, Any]:
        """Do an act, have it on disk, infer the rest anew, and tell the state."""
        start = time.perf_counter()
        view = self._view_or_last(name)
        work = self._work(name, user, view)
        work.add(self._completed(act, work, view))
        return {
            **self._state(name, work, view),
            "milliseconds": 1000 * (time.perf_counter() - start),
        }

    def _completed(self, act: AnyAct, work: Work, view: PictureView) -> AnyAct:
        """The act with its time and with the pixels that it is about."""
        changes: dict[str, Any] = {"time": round(time.time(), 3)}
        if isinstance(act, SuperpixelStroke):
            count = len(view.segment_odds)
            if any(number >= count for number in act.segments):
                what = f"has {count} superpixels, and one of a higher number was clicked"
                raise InputError(work.path.name, what, "load the page again")
            chosen = np.isin(view.labels.numpy(), act.segments)
            changes["runs"] = runs_of(at_size(chosen, view.size))
        if isinstance(act, Right):
            changes["runs"] = runs_of(shown_road(self._odds(work, view), work.labels, view.size))
        return act.model_copy(update=changes)

    def _odds(self, work: Work, view: PictureView) -> Any:
        said = said_of_segments(work.labels, view, self.settings)
        return mended_odds(view, said, self.settings.propagation)

    def _state(self, name: str, work: Work, view: PictureView) -> dict[str, Any]:
        shape = (view.labels.shape[0], view.labels.shape[1])
        road = shown_road(self._odds(work, view), work.labels, shape)
        layout = np.minimum(mended_layout(view, work.labels, self.settings), 3)
        layers = at_size(work.labels, shape) | road.astype(np.uint8) << 3 | layout << 4
        return {
            "name": name,
            "size": [view.size[1], view.size[0]],
            "shape": [shape[1], shape[0]],
            "trust": self._trust(name),
            "version": len(work.acts),
            "acts": [[act.id, act.kind, getattr(act, "saying", "")] for act in work.standing()],
            "redo": work.taken_back(),
            "right": work.confirmed,
            "seconds": round(work.seconds, 1),
            "clicks": len(work.acts),
            "agreement": self.agreement(name),
            "layers": layers.astype(np.uint8).tobytes(),
        }

    def agreement(self, name: str) -> float | None:
        """Share of the pixels that two people spoke of on which they agree; None without two."""
        users = sorted(self._work_by_picture().get(name, {}))
        if len(users) < 2:
            return None
        return agreement_share([self._work(name, user, None).labels for user in users])


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
                session.trusts[name] = _trust_of(session, name)
            except (InputError, OSError):
                failed.add(name)
        stop.wait(2)


def _trust_of(session: Session, name: str) -> float:
    """The trust of a picture, looked at now if it was not; NaN where the detector gives none."""
    path = session.pictures.path(name)
    if session.order is not None:
        session.order.look(name, path, session.view(name))
    trust = session.views.trust(name, path)
    if trust is None:
        seen = session.view(name).trust
        trust = np.nan if seen is None else seen
    return trust
