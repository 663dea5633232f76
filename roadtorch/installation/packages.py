"""The packages that roadtorch and its extras need: whether they are there, and which version."""

from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, metadata, requires, version

from packaging.requirements import Requirement

from roadtorch.installation.check import Check

PACKAGE = "roadtorch"
OF_DEVELOPERS = ("docs", "test")  # extras that users have no need of


def check_packages() -> list[Check]:
    """Every package that roadtorch cannot do without, in the order of the names."""
    return [_needed(one) for one in sorted(_requirements(""), key=lambda one: one.name)]


def check_extras() -> list[Check]:
    """Every extra: ok when all its packages are there."""
    known = metadata(PACKAGE).get_all("Provides-Extra") or []
    return [_extra(name, _requirements(name)) for name in sorted({*known} - {*OF_DEVELOPERS})]


def _requirements(extra: str) -> Iterator[Requirement]:
    """What an extra adds; of the extra "", what is needed without any."""
    for text in requires(PACKAGE) or []:
        one = Requirement(text)
        without = one.marker is None or one.marker.evaluate({"extra": ""})
        wanted = one.marker is None or one.marker.evaluate({"extra": extra})
        if wanted and without == (not extra):
            yield one


def _needed(one: Requirement) -> Check:
    found, wrong = _found(one)
    if wrong:
        return Check(one.name, "broken", wrong, f"pip install '{one.name}{one.specifier}'")
    return Check(one.name, "ok", found)


def _extra(name: str, needed: Iterable[Requirement]) -> Check:
    looked = [(one, *_found(one)) for one in needed]
    absent = [f"{one.name} {wrong}" for one, _, wrong in looked if wrong]
    if absent:
        return Check(name, "missing", ", ".join(absent), f"pip install '{PACKAGE}[{name}]'")
    return Check(name, "ok", ", ".join(f"{one.name} {found}" for one, found, _ in looked))


def _found(one: Requirement) -> tuple[str, str]:
    """The version that is there, and what is wrong with it; one of the two is empty."""
    try:
        found = version(one.name)
    except PackageNotFoundError:
        return "", "is not installed"
    if not one.specifier.contains(found, prereleases=True):
        return "", f"{found} is there, and {one.specifier} is needed"
    return found, ""
