"""The site builds without warnings, and executed pages show what happens."""

import ast
import builtins
import re
import subprocess
import sys
import zlib
from base64 import b64encode
from pathlib import Path
from textwrap import dedent

import pytest

import roadtorch
from docs._extensions.notebooks import JPEG, same_notebook
from roadtorch.cli.group import COMMANDS
from roadtorch.detectors.catalogue import ENTRIES
from roadtorch.oneclass import CLASSIFIERS
from scripts.build_site import broken_links
from scripts.tutorials import executed_pages, run_page, same_line

ROOT = Path(__file__).resolve().parents[2]


def test_the_site_is_whole_and_its_reference_complete(tmp_path: Path) -> None:
    site = tmp_path / "site"
    build = [sys.executable, "scripts/build_site.py", "--out", str(site)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr  # no warning, no broken link

    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f'id="command-{name}"' not in commands] == []

    settings = (site / "reference" / "settings.html").read_text(encoding="utf-8")
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
        ('<link rel="stylesheet" href="//fonts.example/x.css">', "is loaded from elsewhere"),
    ],
)
def test_a_planted_fault_is_found(tmp_path: Path, body: str, wrong: str) -> None:
    (tmp_path / "page.html").write_text(body)

    (message,) = broken_links(tmp_path)
    assert message.endswith(wrong)


PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
FENCED = re.compile(r"^( *)(`{3,})[^`\n]*\n(.*?)^\1\2 *$", re.M | re.S)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_code_of_a_page_fits_and_runs_alone_or_the_text_before_names_its_needs(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for block in FENCED.finditer(text):
        assert max(map(len, block[3].splitlines())) <= 100
        if block[0].lstrip().startswith("```python"):
            paragraph = text[: block.start()].rstrip().rsplit("\n\n", 1)[-1]
            assert names_needed(dedent(block[3])) <= set(re.findall(r"`(\w+)`", paragraph))


def names_needed(code: str) -> set[str]:
    """Return the names that code reads and does not make."""
    nodes = list(ast.walk(ast.parse(code)))
    read = {each.id for each in nodes if isinstance(each, ast.Name)}
    made = {each.id for each in nodes if isinstance(each, ast.Name) and type(each.ctx) is ast.Store}
    made |= {getattr(each, key, None) for each in nodes for key in ("arg", "name", "asname")}
    return read - made - set(dir(builtins))


def test_there_are_no_more_pages_and_words_than_anybody_reads() -> None:
    cards = ROOT.glob("roadtorch/weights/*.md")
    texts = (*PAGES, ROOT / "CHANGELOG.md", ROOT / "train/README.md", *cards)

    assert len(PAGES) <= 42
    assert sum(len(path.read_text(encoding="utf-8").split()) for path in texts) <= 31_000


# --- tutorials --------------------------------------------------------------------------


def test_pages_with_commands_show_what_they_print() -> None:
    assert len(list(executed_pages())) >= 8

    check = [sys.executable, "scripts/tutorials.py", "check"]
    done = subprocess.run(check, cwd=ROOT, capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("expected", "line", "is_same"),
    [
        ("6 done; results in roads", "6 done; results in roads", True),
        ("mean 0.924  0.858", "mean   0.925 0.857", True),
        ("error 0.2943, 8 samples in 1 s", "error 0.2944, 8 samples in 27 s", True),
        ("error 0.2943, 8 samples in 1 s", "error 0.2950, 8 samples in 1 s", False),
        ("config.toml …", "config.toml and anything else", True),
        ("6 done", "5 done", False),
        ("mean 0.924", "mean 0.824", False),
        ("mean 0.924", "mean -0.924", False),
        ("config.toml …", "index.csv and anything else", False),
    ],
)
def test_lines_same_but_for_spaces_times_and_digits(
    expected: str, line: str, is_same: bool
) -> None:
    assert same_line(expected, line) is is_same


def test_a_page_with_planted_faults_comes_back_mended() -> None:
    """Check that equal output stays as written, and left-out output stays out."""
    page = """```console
$ echo took 5 s
took 3 s
$ echo 3 \\
    roads
4 roads
$ printf 'name  F   ms\\nfusion  0.4  23.1\\n'
name  F  …
fusion  0.9  …
$ printf 'a\\nb\\nc\\nd\\n'
a
…
d
$ printf 'a\\nb\\nc\\n'
a
…
d
```
```python
x = 1
print(x)
```
```text
2
```
"""
    right = page.replace("4 roads", "3 roads").replace("0.9", "0.4").replace("text\n2", "text\n1")
    right = right.replace("\na\n…\nd\n```", "\na\nb\nc\n```")

    assert run_page(page, []) == right


def test_the_notebook_is_small_and_another_text_or_picture_in_it_is_noticed() -> None:
    notebook = (ROOT / "docs/quickstart.ipynb").read_text(encoding="utf-8")
    picture = b64encode((ROOT / "docs/figures/p2-fig3.png").read_bytes()).decode()

    assert len(notebook) < 300 * 1024
    for other in (notebook.replace("fusion", "cpf"), JPEG.sub(picture, notebook)):
        assert not same_notebook(notebook, other)
