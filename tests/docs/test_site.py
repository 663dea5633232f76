"""The site: it builds without a warning, its links lead somewhere, the reference is complete."""

import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

import roadtorch
from roadtorch.cli.group import COMMANDS
from roadtorch.detectors.catalogue import ENTRIES
from roadtorch.oneclass import CLASSIFIERS
from scripts.build_site import broken_links

ROOT = Path(__file__).resolve().parents[2]
TABLE = re.compile(r"<!-- table.*?<!-- end -->", re.S)


def test_the_site_is_whole_and_its_reference_complete(tmp_path: Path) -> None:
    site = tmp_path / "site"
    build = [sys.executable, "scripts/build_site.py", "--out", str(site)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr  # no warning, no broken link

    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f'id="command-{name}"' not in commands] == []

    folder = site / "reference" / "settings"
    settings = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.html"))
    names = [f"settings-{entry.name.replace(':', '-')}" for entry in ENTRIES if not entry.grid]
    names += [name.replace("_", "-") for name in CLASSIFIERS]
    assert [name for name in names if f'id="{name}"' not in settings] == []

    # objects.inv has a line for each name that can be linked to, packed behind four of a header.
    packed = (site / "objects.inv").read_bytes().split(b"\n", 4)[4]
    known = {line.split(" ")[0] for line in zlib.decompress(packed).decode().splitlines()}
    public = [getattr(roadtorch, name) for name in roadtorch.__all__ if name != "__version__"]
    assert {f"{member.__module__}.{member.__qualname__}" for member in public} <= known

    equations = (site / "how" / "layout_texture.html").read_text(encoding="utf-8")
    assert equations.count("<math ") > 5


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        ('<a href="none.html">x</a>', "there is no such file"),
        ('<a href="#none">x</a>', "there is no such place in it"),
        ('<script src="https://cdn.example/x.js"></script>', "is loaded from elsewhere"),
        ('<link rel="stylesheet" href="//fonts.example/x.css">', "is loaded from elsewhere"),
    ],
)
def test_a_planted_fault_is_found(tmp_path: Path, body: str, wrong: str) -> None:
    (tmp_path / "page.html").write_text(body)

    (message,) = broken_links(tmp_path)
    assert message.endswith(wrong)


@pytest.mark.parametrize(("research", "most"), [(False, 22_000), (True, 12_000)])
def test_pages_have_no_more_words_than_anybody_reads(research: bool, most: int) -> None:
    """What people wrote; not what is made of code and records, nor comments."""
    texts = [
        re.sub("<!--.*?-->", "", TABLE.sub("", path.read_text(encoding="utf-8")))
        for path in (ROOT / "docs").rglob("*.md")
        if ("research" in path.parts) == research
    ]

    assert sum(len(text.split()) for text in texts) <= most
