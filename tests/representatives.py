"""Detectors that stand for all: of a grid of hundreds, one for each way of working."""

from typing import Any

from roadtorch.detectors.catalogue import detector_entry, detector_groups


def representatives() -> list[str]:
    """Names of detectors without those of grids that differ in their second option alone.

    Of ``oneclass:nn:…`` the first stays, of the next classifier the second, and so on, so
    that few names see most of the options.
    """
    found, grids = [], {}
    for entries in detector_groups().values():
        for entry in entries:
            if entry.grid is None:
                found.append(entry.name)
            else:
                grids.setdefault((entry.grid.name, entry.name.split(":")[1]), []).append(entry.name)
    return found + [members[number % len(members)] for number, members in enumerate(grids.values())]


def quick(name: str) -> dict[str, Any]:
    """Settings by which a detector that learns a dictionary for each picture learns a small one."""
    learns = "dictionary" in detector_entry(name).settings.model_fields
    return {"dictionary": {"bases": 20, "rounds": 3}} if learns else {}
