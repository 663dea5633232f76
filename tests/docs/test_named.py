"""What documents beside the site name exists, and what they show runs."""

import re
import sys
from fnmatch import fnmatch
from pathlib import Path
from textwrap import dedent
from types import ModuleType

import pytest

from roadtorch.base.errors import RoadtorchError
from roadtorch.base.settings import parse_assignments
from roadtorch.detectors.catalogue import detector_entry, list_detectors
from scripts.figures import FIGURES

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("papers", "p2", "ufl", "oneclass")
FAMILIES = ("ufl", "fusion", "cpf", "layout", "prior", "oneclass")
SETTINGS_OF = (
    "ufl",
    "fusion:paper",
    *(f"oneclass:{name}:RGB" for name in ("svdd", "robust_gaussian", "mog2", "dlp", "hist64_s")),
)


def is_setting(assignment: str) -> bool:
    """Whether some detector of the papers takes ``group.key=value``."""
    for name in SETTINGS_OF:
        try:
            detector_entry(name).configured(parse_assignments([assignment]))
        except RoadtorchError:
            continue
        return True
    return False


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_of_the_papers_names_exists(page: str) -> None:
    text = (ROOT / "docs/research" / f"{page}.md").read_text(encoding="utf-8")
    named = re.findall(r"`([^`\s]+)`", text)
    known = [*list_detectors("*"), *list_detectors("oneclass:*:*"), "prior:mean"]

    detectors = [n for n in named if ":" in n and n.split(":")[0] in FAMILIES and "<" not in n]
    assert [n for n in detectors if not any(fnmatch(name, n) for name in known)] == []
    assert [n for n in named if re.fullmatch(r"\w+\.\w+=[\w.]+", n) and not is_setting(n)] == []
    assert [
        n
        for n in named
        if re.match(r"(tests|configs|train|scripts)/", n) and not (ROOT / n).exists()
    ] == []
    assert [n for n in re.findall(r"scripts/figures (\S+)", text) if n not in FIGURES] == []
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (ROOT / "docs/research" / target).exists(), target


def test_modules_that_the_page_of_the_architecture_names_exist() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+\.py)`", page)

    assert named
    assert [name for name in named if not (ROOT / "roadtorch" / name).is_file()] == []


def test_the_detector_of_contributing_keeps_to_the_contract(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    module = ModuleType("their_package")
    monkeypatch.setitem(sys.modules, "their_package", module)

    exec("\n".join(map(dedent, blocks)), vars(module))

    assert module.ENTRY.name == "bright"
    assert module.check_detector
