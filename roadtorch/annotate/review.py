"""What is to be looked at again: a second person's verdict, and confirmations without a look. Ours.

A review is written to the log that it is about, with the name of who did it: ``Review`` says that
a confirmation is right, ``Undo`` reopens the picture.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from roadtorch.data.event_log import EventLog
from roadtorch.data.events import AnyEvent, Confirm, Redo, Review, Undo, standing
from roadtorch.errors import InputError

GLANCE = 1.0
"""Seconds at work on a picture below which nobody has looked at it."""

RUN = 10
"""Confirmations in a row below ``GLANCE`` from which the person is told. Forbidden is nothing."""


class Confirmation(NamedTuple):
    """When a picture was called right that still is, seconds since 1970, and the seconds at it."""

    time: float
    seconds: float


def confirmation(events: Sequence[AnyEvent]) -> Confirmation | None:
    """The last one of a log that holds, with all the work before it; None without any."""
    last = next((one for one in reversed(standing(events)) if isinstance(one, Confirm)), None)
    if last is None:
        return None
    return Confirmation(last.time, sum(one.seconds for one in events if one.time <= last.time))


def hasty_runs(confirmations: Iterable[Confirmation]) -> list[int]:
    """At each of one person's confirmations, how many up to it in a row took less than a glance."""
    runs = [0]
    for one in sorted(confirmations):
        runs.append(runs[-1] + 1 if one.seconds < GLANCE else 0)
    return runs


def hasty_people(logs: Iterable[EventLog]) -> dict[str, int]:
    """By name, the longest hasty run of everybody who had one of ``RUN`` or more."""
    known: dict[str, list[Confirmation]] = {}
    for log in logs:
        if (one := confirmation(log.events)) is not None:
            known.setdefault(log.head.user, []).append(one)
    found = {user: max(hasty_runs(each)) for user, each in sorted(known.items())}
    return {user: most for user, most in found.items() if most >= RUN}


def check_reviewer(user: str, event: AnyEvent, events: Sequence[AnyEvent]) -> None:
    """Whether a second person may do this to a user's log.

    Raises InputError for one's own work, and for anything but calling a confirmation right,
    taking it back, and doing either again.
    """
    by = event.by if isinstance(event, Review | Undo | Redo) else None
    if by is None:
        return
    if by == user:
        raise InputError(user, "is who confirmed", "have a second person review it")
    of = event.of if isinstance(event, Review | Undo | Redo) else ""
    verdicts = Confirm if isinstance(event, Review) else (Confirm, Review)
    if not any(one.id == of and isinstance(one, verdicts) for one in events):
        raise InputError(of, f"is no verdict of {user}", "review what was called right")
