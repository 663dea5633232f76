"""Detectors that stand for all: of a grid of hundreds, one for each way of working."""

from collections.abc import Iterable

from roadtorch.detectors.catalogue import detector_entry


def representatives(names: Iterable[str]) -> list[str]:
    """Names of detectors without those of grids that differ in their last option alone.

    Of ``oneclass:nn:…`` the first stays, of the next classifier the second, and so on, so
    that few names see most of the options.
    """
    found, grids = [], {}
    for name in names:
        if detector_entry(name).grid is None:
            found.append(name)
        else:
            grids.setdefault(name.rpartition(":")[0], []).append(name)
    return found + [members[number % len(members)] for number, members in enumerate(grids.values())]
