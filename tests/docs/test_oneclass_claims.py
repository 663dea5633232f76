"""What docs/research/oneclass.md says carries over from P3, computed from both tables."""

import csv
from collections.abc import Mapping
from pathlib import Path

import pytest
from scipy.stats import spearmanr

RESEARCH = Path(__file__).resolve().parents[2] / "docs" / "research"
COMBINATIONS = ("RGB", "nrng", "O1O2", "Lab", "HSV", "HS")

Cells = Mapping[tuple[str, str], float]


@pytest.fixture(scope="module")
def tables() -> tuple[Cells, Cells]:
    """Ours on CamVid and P3's own, by classifier and planes."""
    with (RESEARCH / "oneclass_table3.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    ours, printed = (
        {(row["classifier"], row["representation"]): float(row[key]) for row in rows if row[key]}
        for key in ("camvid", "p3")
    )
    return ours, printed


def apart(cells: Cells, names: tuple[str, ...], combinations: bool | None) -> float:
    """By how much classifiers differ at most, in single planes, in combinations, or in all."""
    planes = {key[1] for key in cells}
    wanted = {one for one in planes if combinations in (None, one in COMBINATIONS)}
    spread = [[cells[name, one] for name in names] for one in wanted]
    return max(max(values) - min(values) for values in spread)


@pytest.mark.parametrize(
    ("names", "combinations", "claim"),
    [
        (
            ("svdd", "dlp"),
            None,
            "- SVDD and dLP are one classifier: within {} in every column ({})",
        ),
        (("svdd", "mpm"), False, "MPM is within {} of SVDD in single planes ({})"),
        (
            ("kmeans", "kcentres", "mst"),
            True,
            "the spanning tree are alike in combinations: within {} ({})",
        ),
    ],
)
def test_classifiers_that_are_alike_are_as_alike_as_the_page_says(
    names: tuple[str, ...], combinations: bool | None, claim: str, tables: tuple[Cells, Cells]
) -> None:
    page = " ".join((RESEARCH / "oneclass.md").read_text(encoding="utf-8").split())

    figures = (f"{apart(table, names, combinations):.1f}" for table in tables)

    assert claim.format(*figures).removeprefix("- ") in page


def test_the_robust_gaussian_and_the_plain_one(tables: tuple[Cells, Cells]) -> None:
    ours, printed = tables
    page = " ".join((RESEARCH / "oneclass.md").read_text(encoding="utf-8").split())
    robust = {"ours": "robust_gaussian:paper", "printed": "robust_gaussian"}

    own = max(abs(ours["gaussian", one] - ours[robust["ours"], one]) for one in COMBINATIONS)
    theirs = {
        one: abs(printed["gaussian", one] - printed[robust["printed"], one]) for one in COMBINATIONS
    }

    claim = "within {:.1f} in combinations ({:.1f} but for HSV, where they are {:.1f} apart)"
    others = max(value for one, value in theirs.items() if one != "HSV")
    assert claim.format(own, others, theirs["HSV"]) in page


def test_the_readings_to_the_letter(tables: tuple[Cells, Cells]) -> None:
    ours, printed = tables
    page = " ".join((RESEARCH / "oneclass.md").read_text(encoding="utf-8").split())
    printed = {key: value for key, value in printed.items() if not key[0].endswith(":paper")}
    letter = {key: ours.get((f"{key[0]}:paper", key[1]), ours[key]) for key in printed}

    best = max(letter, key=lambda key: letter[key])
    rank = spearmanr([letter[key] for key in printed], [printed[key] for key in printed])[0]

    assert f"the best of CamVid is `{best[0]}:{best[1]}` with {letter[best]:.1f}" in page
    assert f"over {len(printed)} cells is {rank:+.2f} on CamVid".replace("0.", ".") in page
    for name in ("robust_gaussian", "mog4", "dlp", "pca"):
        cells = (f"{ours[kind, 'RGB']:.1f}" for kind in (f"{name}:paper", name))
        assert "| {} → {} |".format(*cells) in page
