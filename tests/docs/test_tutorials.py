"""The tutorials are executed, and what they print is what their pages say."""

import subprocess
import sys
from pathlib import Path

import pytest

from scripts.tutorials import run_page, same, same_line

ROOT = Path(__file__).resolve().parents[2]


def test_every_page_says_what_happens() -> None:
    folder = ROOT / "docs" / "tutorials"
    pages = sorted(path for path in folder.glob("*.md") if path.stem != "index")
    assert len(pages) >= 7
    assert all("```console\n$ roadtorch " in path.read_text(encoding="utf-8") for path in pages)

    check = [sys.executable, "scripts/tutorials.py", "check", *map(str, pages)]
    done = subprocess.run(check, cwd=ROOT, capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("expected", "line", "is_same"),
    [
        ("6 done; results in roads", "6 done; results in roads", True),
        ("mean 0.924  0.858", "mean   0.925 0.857", True),
        ("error 0.2943, 8 samples in 1 s", "error 0.2950, 8 samples in 27 s", True),
        ("115,200 pixels", "115,300 pixels", True),
        ("config.toml …", "config.toml and anything else", True),
        ("6 done", "5 done", False),
        ("mean 0.924", "mean 0.824", False),
        ("mean 0.924", "mean -0.924", False),
        ("115,200 pixels", "99,000 pixels", False),
        ("roads", "road", False),
        ("config.toml …", "index.csv and anything else", False),
    ],
)
def test_lines_same_but_for_spaces_times_and_digits(
    expected: str, line: str, is_same: bool
) -> None:
    assert same_line(expected, line) is is_same


def test_an_ellipsis_is_any_lines_and_nothing_else_is() -> None:
    assert same(["a", "…", "d"], ["a", "b", "c", "d"])
    assert same(["a", "…"], ["a"])
    assert not same(["a", "…", "d"], ["a", "b", "c"])
    assert not same(["a"], ["a", "b"])
    assert not same(["a", "b"], ["a"])


def test_a_page_with_planted_faults_comes_back_mended() -> None:
    """What is the same stays as it was written, and what was left out stays out."""
    page = """```console
$ echo took 5 s
took 3 s
$ echo 3 \\
    roads
4 roads
$ printf 'name  F   ms\\nfusion  0.4  23.1\\n'
name  F  …
fusion  0.9  …
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

    assert run_page(page) == right
