"""Parts of pages that are made of the code: links, tables of contents, options."""

from pathlib import Path

import click
import pytest

from docs._extensions import generated_parts as parts
from docs._extensions.plain_docstrings import as_restructured


def test_links_lead_to_pages_of_the_site() -> None:
    root = parts.ROOT

    assert parts.linked("[more](docs/many.md#x)", root) == "[more](/many.md#x)"
    assert parts.linked("[why](../train/README.md)", root / "docs") == "[why](/studies.md)"
    assert (
        parts.linked("[docs/research/ufl.md](docs/research/ufl.md)", root) == "[](/research/ufl.md)"
    )
    assert parts.linked("[it](../pyproject.toml)", root / "docs") == "it (`pyproject.toml`)"


def test_a_link_to_nothing_is_left_for_the_build_to_find() -> None:
    assert parts.linked("[x](none.md)", parts.ROOT) == "[x](none.md)"


def test_code_is_left_as_it_is() -> None:
    text = "```\n[x](docs/many.md)\n```\n"

    assert parts.linked(text, parts.ROOT) == text


def test_a_page_that_nobody_lists_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parts, "DOCS", tmp_path)
    for name in ("new", "known", "optional"):
        (tmp_path / f"{name}.md").write_text("# A page\n")
    (tmp_path / "index.md").write_text("```{toctree}\nknown\n```\n{{ contents optional? none? }}\n")

    assert "/new\n" in parts.unlisted([])
    assert "known" not in parts.unlisted([])
    assert parts.contents(["optional?", "none?"]).splitlines()[3:] == ["/optional", "```"]


def test_help_says_just_what_it_says() -> None:
    command = click.Command("x", help="Write *all* of A_B.\n\n\b\nA  is kept\n   as it is")

    told = list(parts.help_text(command))
    assert told == [
        "Write \\*all\\* of A\\_B.",
        "",
        "```text",
        "A  is kept\n   as it is",
        "```",
        "",
    ]


def test_docstrings_become_plain_text_with_code() -> None:
    lines = ["|x| of ``a*b``,", "    wrapped.", "", "    in = code", "", "- one", "  more", "- two"]

    assert as_restructured(lines) == [
        *("\\|x\\| of ``a*b``, wrapped.", ""),
        *("::", "", "        in = code", ""),
        *("- one more", "- two", ""),
    ]
