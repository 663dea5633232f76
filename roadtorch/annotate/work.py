"""One person's work on one picture: the journal and what it comes to so far."""

import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from roadtorch.data.journal import (
    JournalHead,
    append_act,
    read_journal,
    start_journal,
)
from roadtorch.data.strokes import (
    AnyAct,
    Brought,
    Redo,
    Right,
    Stroke,
    Undo,
    apply_act,
    folded,
    standing,
)


@dataclass
class Work:
    """What a journal holds, kept up to date act by act.

    head: the journal's first line, written with the first act. acts: all of them, each once.
    labels: uint8 (H,W), what they come to.
    """

    path: Path
    head: JournalHead
    acts: list[AnyAct]
    labels: np.ndarray
    _ids: set[str] = field(default_factory=set, repr=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False)

    def __post_init__(self) -> None:
        self._ids = {act.id for act in self.acts}

    def add(self, act: AnyAct) -> bool:
        """Do an act and have it on disk; False, and nothing done, for one that is there already.

        Raises InputError for one that does not fit the picture, or cannot be written.
        """
        with self._lock:
            if act.id in self._ids:
                return False
            labels = self._after(act)
            start_journal(self.path, self.head)
            append_act(self.path, act)
            self.acts.append(act)
            self._ids.add(act.id)
            self.labels = labels
            return True

    def _after(self, act: AnyAct) -> np.ndarray:
        if isinstance(act, Undo | Redo):
            return folded([*self.acts, act], (self.head.height, self.head.width))
        labels = self.labels.copy()
        apply_act(labels, act)
        return labels

    def standing(self) -> list[Stroke | Right | Brought]:
        """The acts that hold."""
        return standing(self.acts)

    def taken_back(self) -> list[str]:
        """The acts that can be done again: taken back last comes last, none after a new act."""
        stack: list[str] = []
        for act in self.acts:
            if isinstance(act, Undo):
                stack = [*(one for one in stack if one != act.of), act.of]
            elif isinstance(act, Redo):
                stack = [one for one in stack if one != act.of]
            else:
                stack = []
        return stack

    @property
    def confirmed(self) -> bool:
        """Whether the person said that it is right as it is."""
        return any(isinstance(act, Right) for act in self.standing())

    @property
    def seconds(self) -> float:
        """At work on the picture."""
        return sum(act.seconds for act in self.acts)


def open_work(path: Path, head: JournalHead) -> Work:
    """The work in a journal, or a new one with this head; DatasetError if it cannot be read."""
    size = (head.height, head.width)
    if not path.exists():
        return Work(path, head, [], np.zeros(size, np.uint8))
    journal = read_journal(path)
    size = (journal.head.height, journal.head.width)
    return Work(path, journal.head, list(journal.acts), folded(journal.acts, size))
