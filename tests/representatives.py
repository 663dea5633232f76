"""Detectors that stand for all: of a grid of hundreds, one for each way of working."""

from roadtorch.detectors.catalogue import detector_groups


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
