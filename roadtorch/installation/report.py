"""All that is found out about an installation, as text and as JSON."""

import importlib
from collections.abc import Iterable, Iterator
from typing import Any

from roadtorch.installation.check import Check
from roadtorch.io.bounded import reason
from roadtorch.version import __version__

SECTIONS = {
    "machine": "roadtorch.installation.machine:check_machine",
    "packages": "roadtorch.installation.packages:check_packages",
    "extras": "roadtorch.installation.packages:check_extras",
    "codecs": "roadtorch.installation.codecs:check_codecs",
    "weights": "roadtorch.installation.weights:check_weights",
    "self-test": "roadtorch.installation.self_test:check_self_test",
}
"""What is looked at, in this order: names, so that what cannot be imported breaks itself alone."""

Report = dict[str, list[Check]]


def examine() -> Report:
    """Look at every section."""
    return {section: _looked(section, place) for section, place in SECTIONS.items()}


def _looked(section: str, place: str) -> list[Check]:
    module, name = place.split(":")
    try:
        return getattr(importlib.import_module(module), name)()
    except Exception as problem:  # an installation can be broken in any way
        what = f"{type(problem).__name__}: {reason(problem)}"
        return [Check(section, "broken", what, "install roadtorch again")]


def is_well(report: Report) -> bool:
    """Whether nothing is broken; what is missing can be done without."""
    return all(check.state != "broken" for checks in report.values() for check in checks)


def as_text(report: Report) -> str:
    """A line for each check under the name of its section; the remedies in brackets."""
    width = max(len(check.name) for checks in report.values() for check in checks)
    lines = (f"\n{section}\n" + "\n".join(_lines(report[section], width)) for section in report)
    return f"roadtorch {__version__}\n" + "\n".join(lines)


def _lines(checks: Iterable[Check], width: int) -> Iterator[str]:
    for check in checks:
        remedy = f" ({check.remedy})" if check.remedy else ""
        yield f"  {check.state:<8} {check.name:<{width}}  {check.what}{remedy}"


def as_document(report: Report) -> dict[str, Any]:
    """The same for programs: as JSON can hold it."""
    checks = [
        {"section": section, **vars(check), "figures": dict(check.figures)}
        for section, found in report.items()
        for check in found
    ]
    return {"roadtorch": __version__, "well": is_well(report), "checks": checks}
