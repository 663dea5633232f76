"""Parts of pages that are made of the code: links, tables of contents, options."""

from pathlib import Path

import pytest

from docs._extensions import generated_parts as parts


@pytest.mark.parametrize(
    ("text", "folder", "linked"),
    [
        ("[more](docs/many.md#x)", "", "[more](/many.md#x)"),
        ("[why](../train/README.md)", "docs", "[why](/studies.md)"),
        ("[docs/research/ufl.md](docs/research/ufl.md)", "", "[](/research/ufl.md)"),
        ("[it](../pyproject.toml)", "docs", "it (`pyproject.toml`)"),
        ("[x](none.md)", "", "[x](none.md)"),  # left for the build to find
        ("```\n[x](docs/many.md)\n```\n", "", "```\n[x](docs/many.md)\n```\n"),
    ],
)
def test_links_lead_to_pages_of_the_site(text: str, folder: str, linked: str) -> None:
    assert parts.linked(text, parts.ROOT / folder) == linked


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
