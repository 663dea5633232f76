"""What docs/research/oneclass.md says carries over from P3, computed from both tables."""

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path

from scipy.stats import spearmanr

RESEARCH = Path(__file__).resolve().parents[2] / "docs" / "research"
COMBINATIONS = ("RGB", "nrng", "O1O2", "Lab", "HSV", "HS")

Cells = Mapping[tuple[str, str], float]


def tables() -> Iterator[Cells]:
    """Scores by classifier and planes: ours on CamVid, and those that P3 prints."""
    with (RESEARCH / "oneclass_table3.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for key in ("camvid", "p3"):
        yield {
            (row["classifier"], row["representation"]): float(row[key]) for row in rows if row[key]
        }


def apart(cells: Cells, names: tuple[str, ...], combinations: bool | None = None) -> float:
    """By how much classifiers differ at most, in single planes, in combinations, or in all."""
    planes = {key[1] for key in cells}
    wanted = {one for one in planes if combinations in (None, one in COMBINATIONS)}
    spread = [[cells[name, one] for name in names] for one in wanted]
    return max(max(values) - min(values) for values in spread)


def claims() -> Iterator[str]:
    """Sentences of the page with the figures that the tables give."""
    ours, printed = tables()
    both = (ours, printed)
    for names, combinations, claim in (
        (("svdd", "dlp"), None, "SVDD and dLP are one classifier: within {} in every column ({})"),
        (("svdd", "mpm"), False, "MPM is within {} of SVDD in single planes ({})"),
        (("kmeans", "kcentres", "mst"), True, "tree are alike in combinations: within {} ({})"),
    ):
        yield claim.format(*(f"{apart(table, names, combinations):.1f}" for table in both))

    robust = "robust_gaussian:paper"
    own = max(abs(ours["gaussian", one] - ours[robust, one]) for one in COMBINATIONS)
    theirs = {
        one: abs(printed["gaussian", one] - printed["robust_gaussian", one]) for one in COMBINATIONS
    }
    hsv = theirs.pop("HSV")
    others = max(theirs.values())
    yield f"within {own:.1f} in combinations ({others:.1f} but for HSV, where they are {hsv:.1f}"

    cells = [key for key in printed if not key[0].endswith(":paper")]
    letter = {key: ours.get((f"{key[0]}:paper", key[1]), ours[key]) for key in cells}
    best = max(letter, key=lambda key: letter[key])
    rank = spearmanr([letter[key] for key in cells], [printed[key] for key in cells])[0]
    yield f"the best of CamVid is `{best[0]}:{best[1]}` with {letter[best]:.1f}"
    yield f"over {len(cells)} cells is {rank:+.2f} on CamVid".replace("0.", ".")
    for name in ("robust_gaussian", "mog4", "dlp", "pca"):
        row = (f"{ours[kind, 'RGB']:.1f}" for kind in (f"{name}:paper", name))
        yield "| {} → {} |".format(*row)


def test_the_page_says_what_the_tables_say() -> None:
    page = " ".join((RESEARCH / "oneclass.md").read_text(encoding="utf-8").split())

    assert [claim for claim in claims() if claim not in page] == []
