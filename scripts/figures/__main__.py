"""Draw a figure or print a table of the three papers, on the data at hand.

    python scripts/figures --list
    python scripts/figures p3-table2 DATA --out results/papers

DATA holds camvid/, idd_lite/, kitti_road/ and many/. P1 is Zhang et al., ICPR 2016; P2 Álvarez et
al., ECCV 2012; P3 Álvarez et al., arXiv 1412.3506. What each command shows, and how it compares
with the paper: docs/research/papers.md. Figures that are drawings without a value, and studies, are
in the history: train/README.md.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # for the package beside

from scripts.figures import FIGURES


def main() -> None:
    parser = argparse.ArgumentParser(description="Figures and tables of the papers.")
    parser.add_argument("name", nargs="?", choices=tuple(FIGURES), metavar="NAME")
    parser.add_argument("data", nargs="?", type=Path, metavar="DATA")
    parser.add_argument("--out", type=Path, default=Path("results/papers"))
    parser.add_argument("--list", action="store_true", help="print the names")
    arguments = parser.parse_args()
    if arguments.list:
        for name, figure in FIGURES.items():
            print(f"{name:12} {(figure.__doc__ or '').splitlines()[0]}")
    elif arguments.name is None or arguments.data is None:
        parser.error("give NAME and DATA, or --list")
    else:
        arguments.out.mkdir(parents=True, exist_ok=True)
        FIGURES[arguments.name](arguments.data, arguments.out)


if __name__ == "__main__":
    main()
