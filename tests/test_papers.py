"""The pages of the papers: every detector, setting, file and command that they name exists."""

import re
from fnmatch import fnmatch
from pathlib import Path

import pytest

from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.errors import RoadtorchError
from roadtorch.settings import parse_assignments
from scripts.figures import FIGURES

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("papers", "p2", "ufl", "oneclass")
FAMILIES = ("ufl", "fusion", "cpf", "layout", "prior", "oneclass")
SETTINGS_OF = (
    "ufl",
    "fusion:paper",
    *(f"oneclass:{name}:RGB" for name in ("svdd", "robust_gaussian", "mog2", "dlp", "hist64_s")),
)


def text_of(page: str) -> str:
    return (ROOT / "docs/research" / f"{page}.md").read_text(encoding="utf-8")


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
def test_what_a_page_names_exists(page: str) -> None:
    text = text_of(page)
    named = re.findall(r"`([^`\s]+)`", text)
    known = [*list_detectors("*"), *list_detectors("oneclass:*:*"), "prior:mean"]

    detectors = [n for n in named if ":" in n and n.split(":")[0] in FAMILIES and "<" not in n]
    assert [n for n in detectors if not any(fnmatch(one, n) for one in known)] == []
    assert [n for n in named if re.fullmatch(r"\w+\.\w+=[\w.]+", n) and not is_setting(n)] == []
    assert [
        n
        for n in named
        if re.match(r"(tests|configs|train|scripts)/", n) and not (ROOT / n).exists()
    ] == []
    assert [n for n in re.findall(r"scripts/figures (\S+)", text) if n not in FIGURES] == []
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (ROOT / "docs/research" / target).exists(), target
