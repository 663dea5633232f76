"""Draw a figure or print a table of the three papers, or all of them, on the data at hand.

    python scripts/figures --help
    python scripts/figures p3-table3 DATA --out results/papers
    python scripts/figures all DATA --out results/papers

DATA holds camvid/, idd_lite/, kitti_road/, many/, unlabelled_free/ and simulated/. P1 is Zhang et
al., ICPR 2016; P2 Álvarez et al., ECCV 2012; P3 Álvarez et al., arXiv 1412.3506. docs/research/
figures.md shows all of them beside what the papers show.

``all`` skips a figure whose files exist, so that the same command resumes; a figure that fails, for
example because a data set is missing, takes one line, and the next ones are made.
"""

import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # for the package beside

from scripts.figures import FIGURES


def make_all(data: Path, out: Path) -> list[str]:
    """Make every figure whose files do not exist yet; returns the names of those that failed."""
    failed, began = [], time.monotonic()
    for name, figure in FIGURES.items():
        if all((out / f"{name}{end}").exists() for end in figure.endings):
            print(f"{name}: exists", flush=True)
            continue
        start = time.monotonic()
        try:
            figure.make(data, out)
        except Exception as error:  # whatever fails, the next figure is made
            message = " ".join(str(error).split())
            print(f"{name}: failed: {type(error).__name__}: {message}", flush=True)
            failed.append(name)
        else:
            print(f"{name}: made in {time.monotonic() - start:.0f} s", flush=True)
    print(f"all of them in {time.monotonic() - began:.0f} s", flush=True)
    return failed


def main() -> None:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=("all", *FIGURES))
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("results/papers"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.name != "all":
        FIGURES[options.name].make(options.data, options.out)
    elif make_all(options.data, options.out):
        sys.exit(1)


if __name__ == "__main__":
    main()
