"""The two sets of weights side by side, as docs/weights.md has them.

    python scripts/weights_table.py RESULTS                       # prints the tables
    python scripts/weights_table.py RESULTS --into docs/weights.md  # and puts them in their place

RESULTS holds what ``roadtorch evaluate`` wrote of two detectors each, with that of the research
weights as ``--against``: folders SET-DETECTOR such as many-fusion, with metrics.json.
"""

import argparse
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

BEGIN, END = "<!-- weights_table -->", "<!-- /weights_table -->"
"""Between these lines of a document the tables stand."""

FIGURES = {"f_mask": "F", "maxf": "MaxF"}
"""By key of metrics.json, what the tables call it: of the mask at the default, of the best one."""

SAME_SOURCE = ("comma10k", "dn_cat", "dn_mcubes")
"""Folders of many/ of whose sources there are pictures among the free ones."""

SETS = {
    "camvid": "CamVid",
    "idd": "IDD",
    "many": "many, 14 folders",
    "many11": "many, the 11 without †",
}


class Pair(NamedTuple):
    """One metrics.json: figures of the research weights and of the free ones, and the rest."""

    research: Mapping[str, Any]
    free: Mapping[str, Any]
    difference: Mapping[str, Any]
    images: int


def read_pair(path: Path) -> Pair:
    """The two detectors of a metrics.json; the one that the other is compared with is first."""
    found = json.loads(path.read_text(encoding="utf-8"))
    against = found["paired"]["against"]
    others = [
        name
        for name, one in found["detectors"].items()
        if name != against and not one.get("baseline", one.get("floor"))  # its name before
    ]
    if len(others) != 1:
        raise SystemExit(f"{path}: holds {len(others) + 1} detectors (evaluate two)")
    change = found["paired"]["detectors"][others[0]]
    one, other = (found["detectors"][name] for name in (against, others[0]))
    counted = sum(group["images"] for group in one.get("groups", {}).values())
    return Pair(one, other, change, counted or found["images"])


def main_table(results: Path) -> Iterator[str]:
    """A row for each set and detector: both figures, and free less research with its interval."""
    yield "| set | pictures | detector | measure | research | free | difference (95 %) |"
    yield "|---|---|---|---|---|---|---|"
    for detector in ("fusion", "layout"):
        for key, name in SETS.items():
            path = results / f"{key}-{detector}" / "metrics.json"
            if path.exists():
                yield from _rows(read_pair(path), name, detector)


def _rows(pair: Pair, name: str, detector: str) -> Iterator[str]:
    for key, measure in FIGURES.items():
        change = pair.difference[key]
        low, high = change["ci95"]
        values = f"{pair.research[key]:.3f} | {pair.free[key]:.3f}"
        told = f"{change['difference']:+.3f} ({low:+.3f} to {high:+.3f})"
        yield f"| {name} | {pair.images} | `{detector}` | {measure} | {values} | {told} |"


def folder_table(pair: Pair) -> Iterator[str]:
    """A row for each folder of many/: F and MaxF of both."""
    yield "| folder | F, research | F, free | MaxF, research | MaxF, free |"
    yield "|---|---|---|---|---|"
    for name in sorted(pair.free["groups"]):
        both = [one["groups"][name] for one in (pair.research, pair.free)]
        mark = " †" if name in SAME_SOURCE else ""
        yield _line(f"{name}{mark}", [one[key] for key in FIGURES for one in both])


def _line(name: str, values: Sequence[float]) -> str:
    return f"| {name} | " + " | ".join(f"{value:.3f}" for value in values) + " |"


def placed(document: str, tables: str) -> str:
    """The document with the tables between its two lines; SystemExit where it has none."""
    pattern = re.compile(f"{re.escape(BEGIN)}.*{re.escape(END)}", re.DOTALL)
    if not pattern.search(document):
        raise SystemExit(f"the document has no {BEGIN} … {END}")
    return pattern.sub(lambda _: f"{BEGIN}\n{tables}\n{END}", document)


def main() -> None:
    parser = argparse.ArgumentParser(description="The two sets of weights side by side.")
    parser.add_argument("results", type=Path)
    parser.add_argument("--into", type=Path)
    given = parser.parse_args()
    folders = folder_table(read_pair(given.results / "many-fusion" / "metrics.json"))
    tables = "\n".join([*main_table(given.results), "", *folders])
    print(tables)
    if given.into is not None:
        text = given.into.read_text(encoding="utf-8")
        given.into.write_text(placed(text, tables), encoding="utf-8")


if __name__ == "__main__":
    main()
