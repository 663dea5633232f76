"""Representative detectors: of a grid of hundreds, one for each way of working."""

from typing import Any

from roadtorch.detectors.catalogue import detector_entry, detector_groups


def representatives() -> list[str]:
    """Return the names of detectors, one of each grid's that differ in their second option alone.

    Of ``oneclass:nn:…`` the first stays, of the next classifier the second, and so on, so
    that few names see most of the options.
    """
    names, grids = [], {}
    for entries in detector_groups().values():
        for entry in entries:
            if entry.grid is None:
                names.append(entry.name)
            else:
                grids.setdefault((entry.grid.name, entry.name.split(":")[1]), []).append(entry.name)
    return names + [members[number % len(members)] for number, members in enumerate(grids.values())]


def distinct_detectors() -> list[str]:
    """Return ``representatives`` without presets, which differ only in values or weights."""
    ways: dict[object, str] = {}
    for name in representatives():
        entry = detector_entry(name)
        ways.setdefault(name if entry.grid else (entry.settings, entry.build), name)
    return list(ways.values())


LITTLE: dict[str, dict[str, Any]] = {
    "dictionary": {"dictionary": {"bases": 20, "rounds": 3}, "working": {"rows": 48}},
    "gabor": {"gabor": {"orientations": 16, "scales": 2}, "working": {"pixels": 3200}},
    "samples": {"working": {"pixels": 60 * 80}},
}
"""Settings that make slow detectors quick, by a group of settings that they have."""


def quick(name: str) -> dict[str, Any]:
    """Return settings with which a detector works as usual, on less."""
    fields = detector_entry(name).settings.model_fields
    return next((little for group, little in LITTLE.items() if group in fields), {})
