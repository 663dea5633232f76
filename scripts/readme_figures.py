"""The pictures and the figures of README and docs: made, and held against their sources.

    python scripts/readme_figures.py evaluate DATA   # score, write the documents, check
    python scripts/readme_figures.py write           # documents as docs/figures have them
    python scripts/readme_figures.py --check         # is every figure as its source has it?
    python scripts/readme_figures.py free PAGE       # the figures of a page without a source
    python scripts/readme_figures.py make DATA       # docs/pictures: the steps

DATA holds many/, camvid/, idd_lite/ and unlabelled_free/. ``evaluate`` takes about ten minutes on
two quiet cores; --only NAME… does some of it (camvid-slow, idd-slow: detectors of seconds a
picture, which are in no other run). ``write`` and ``--check`` take seconds. How a figure is bound
to its source: scripts/bound_figures.py.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from scripts import bound_figures, readme_pictures
from scripts.bound_figures import Record
from scripts.readme_evaluations import RUNS, SLOW_RUNS, collect, evaluate, facts
from scripts.readme_tables import TABLES

ROOT = Path(__file__).resolve().parents[1]

FIGURES = Path("docs/figures")
"""Where the records lie, a file a run."""

WHOLLY_BOUND = ("README.md", "docs/adapting.md", "docs/many.md", "docs/results.md")
"""Documents in which a figure without a source is an error."""


def documents(root: Path) -> list[Path]:
    """README and every page of docs."""
    return [root / "README.md", *sorted((root / "docs").glob("*.md"))]


def records(root: Path) -> Mapping[str, Record]:
    """All records of a checkout, those of the benches too, and what the code says."""
    return bound_figures.read_records(sorted((root / FIGURES).glob("*.json"))) | dict(facts())


def used(root: Path) -> set[str]:
    """The records that documents name."""
    texts = [path.read_text(encoding="utf-8") for path in documents(root)]
    return set(bound_figures.names_used(texts, TABLES))


def check(root: Path, known: Mapping[str, Record]) -> list[str]:
    """What is wrong in the documents, a line each; nothing where all is well."""
    wrong = []
    for path in documents(root):
        name, text = path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")
        wrong += [
            f"{name}:{one.line}: {one.what}" for one in bound_figures.stale(text, known, TABLES)
        ]
        if name in WHOLLY_BOUND:
            free = bound_figures.unbound(text)
            wrong += [f"{name}:{line}: {number} has no source" for line, number in free]
    return wrong


def overview(root: Path) -> list[str]:
    """Of each document: figures that are bound, in studies measured once, and without a source."""
    lines = [f"{'document':32} {'bound':>6} {'studies':>8} {'free':>6}"]
    for path in documents(root):
        name, text = path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")
        free = len(bound_figures.unbound(text))
        counts = bound_figures.bound(text), bound_figures.in_studies(text), free
        lines.append(f"{name:32} {counts[0]:6} {counts[1]:8} {counts[2]:6}")
    return lines


def write(root: Path, known: Mapping[str, Record]) -> None:
    """Rewrite the bound figures and tables of all documents."""
    for path in documents(root):
        before = path.read_text(encoding="utf-8")
        after = bound_figures.rewritten(before, known, TABLES)
        if after != before:
            path.write_text(after, encoding="utf-8")
            print(f"{path.relative_to(root)}: rewritten", file=sys.stderr)


def tell(root: Path) -> int:
    """Print how the documents stand; 1 where something is wrong."""
    wrong = check(root, records(root))
    print("\n".join(overview(root)))
    print("\n".join(wrong) if wrong else "every bound figure is as its source has it")
    return 1 if wrong else 0


def arguments_of(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    tasks = parser.add_subparsers(dest="task")
    scored = tasks.add_parser("evaluate", help="score, collect, write and check")
    scored.add_argument("data", type=Path)
    scored.add_argument("--out", type=Path, default=Path("out/figures"), help="of the evaluations")
    every = [run.name for run in (*RUNS, *SLOW_RUNS)]
    scored.add_argument("--only", nargs="*", choices=every, default=[run.name for run in RUNS])
    scored.add_argument("--jobs", type=int, default=2)
    tasks.add_parser("write", help="documents from records")
    listed = tasks.add_parser("free", help="figures without a source")
    listed.add_argument("page", type=Path)
    made = tasks.add_parser("make", help="the pictures")
    made.add_argument("data", type=Path)
    given = parser.parse_args(words)
    if given.check == (given.task is not None):
        parser.error("give --check, or one of evaluate, write, free, make")
    return given


def main(words: Sequence[str] | None = None) -> int:
    given = arguments_of(words)
    if given.task == "free":
        found = bound_figures.unbound(given.page.read_text(encoding="utf-8"))
        print("\n".join(f"{given.page}:{line}: {number}" for line, number in found))
        return 0
    if given.task == "make":
        readme_pictures.make(given.data, ROOT / "docs" / "pictures")
        return 0
    if given.task == "evaluate":
        evaluate(given.data, given.out, given.only, given.jobs)
        collect(given.out, ROOT / FIGURES, used(ROOT))
    if given.task in ("evaluate", "write"):
        write(ROOT, records(ROOT))
    return tell(ROOT)


if __name__ == "__main__":
    sys.exit(main())
