"""Draw a figure or print a table of the three papers, on the data at hand.

    python scripts/figures --help
    python scripts/figures p3-table2 DATA --out results/papers

DATA holds camvid/, idd_lite/, kitti_road/ and many/. P1 is Zhang et al., ICPR 2016; P2 Álvarez et
al., ECCV 2012; P3 Álvarez et al., arXiv 1412.3506. What each command shows, and how it compares
with the paper: docs/how. Figures that are drawings without a value, and studies, are
in the history: train/README.md.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # for the package beside

from scripts.figures import FIGURES


def main() -> None:
    parser = argparse.ArgumentParser(description="Figures and tables of the papers.")
    parser.add_argument("name", choices=tuple(FIGURES))
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("results/papers"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    FIGURES[options.name](options.data, options.out)


if __name__ == "__main__":
    main()
