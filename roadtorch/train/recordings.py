"""Recordings among the images of a run. Ours."""

import math
from collections.abc import Sequence


def recording_name(name: str, separator: str) -> str:
    """Return a name up to its last separator, or all of it if it has none."""
    return name.rpartition(separator)[0] if separator and separator in name else name


def select_held_out(names: Sequence[str], fraction: float, separator: str) -> list[str]:
    """Select a fraction of names, at least one: whole recordings, the smallest first. Ours.

    The last names where recordings are unknown or too large, as neighbouring frames are alike. One
    at least is left to learn from; empty for a single name, or a fraction of 0.
    """
    limit = min(math.ceil(fraction * len(names)), len(names) - 1)
    recordings: dict[str, list[str]] = {}
    for name in sorted(names):
        recordings.setdefault(recording_name(name, separator), []).append(name)
    chosen: list[str] = []
    for recording in sorted(recordings.values(), key=len):
        if len(recordings) < len(names) and len(chosen) + len(recording) <= limit:
            chosen += recording
    return chosen if 2 * len(chosen) > limit else sorted(names)[len(names) - limit :]
