"""The figures and tables of the papers that documents show, by name."""

from collections.abc import Callable, Mapping
from pathlib import Path

from scripts.figures import p1, p2, p3_light, p3_table3

FIGURES: Mapping[str, Callable[[Path, Path], None]] = {
    "p1-table1": p1.table1,
    "p1-table2": p1.table2,
    "p2-fig4b": p2.fig4b,
    "p2-fig4c": p2.fig4c,
    "p2-fig6a": p2.fig6a,
    "p2-fig6b": p2.fig6b,
    "p3-fig8": p3_table3.fig8,
    "p3-fig9": p3_table3.fig9,
    "p3-table2": p3_light.table2,
    "p3-table3": p3_table3.table3,
}
"""By name, what reads the data (first path) and writes images and CSV files to a folder."""
