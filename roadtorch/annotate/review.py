"""What is to be looked at again: a second person's verdict, and confirmations without a look. Ours.

A review is written to the log that it is about, with the name of who did it: ``Review`` says that
a confirmation is right, ``Undo`` reopens the picture.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence

from roadtorch.data.event_log import EventLog
from roadtorch.data.events import AnyEvent, Confirm, Redo, Review, Undo
from roadtorch.errors import InputError

GLANCE = 1.0
"""Seconds at work on a picture below which nobody has looked at it."""

RUN = 10
"""Confirmations in a row below ``GLANCE`` from which the person is told. Forbidden is nothing."""


Confirmation = tuple[float, float]
"""When a picture was called right that still is, seconds since 1970, and the seconds at it."""


def confirmation(log: EventLog) -> Confirmation | None:
    """The last one of a log that holds, with all the work before it; None without any."""
    last = next((one for one in reversed(log.standing) if isinstance(one, Confirm)), None)
    if last is None:
        return None
    return last.time, sum(one.seconds for one in log.events if one.time <= last.time)


def hasty_runs(confirmations: Iterable[tuple[str, Confirmation | None]]) -> dict[str, list[int]]:
    """At each confirmation of a person, how many up to it in a row took less than a glance.

    confirmations: with the name of the person, in any order; so is the result, sorted.
    """
    by_user: dict[str, list[Confirmation]] = defaultdict(list)
    for user, one in confirmations:
        if one is not None:
            by_user[user].append(one)
    found: dict[str, list[int]] = {}
    for user, each in sorted(by_user.items()):
        runs = found[user] = [0]
        for _, seconds in sorted(each):
            runs.append(runs[-1] + 1 if seconds < GLANCE else 0)
    return found


def check_reviewer(user: str, event: AnyEvent, events: Sequence[AnyEvent]) -> None:
    """Whether a second person may do this to a user's log.

    Raises InputError for one's own work, and for anything but calling a confirmation right,
    taking it back, and doing either again.
    """
    if not isinstance(event, Review | Undo | Redo) or event.by is None:
        return
    if event.by == user:
        raise InputError(user, "is who confirmed", "have a second person review it")
    verdicts = Confirm if isinstance(event, Review) else (Confirm, Review)
    if not any(one.id == event.of and isinstance(one, verdicts) for one in events):
        raise InputError(event.of, f"is no verdict of {user}", "review what was called right")
