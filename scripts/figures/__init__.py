"""The figures and tables of the papers, by name, in the papers' order."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from scripts.figures import p1, p1_stages, p2_layout, p2_road, p3_area, p3_page, p3_table3


class PaperFigure(NamedTuple):
    """A figure or table of a paper: its function and the files that it writes.

    ``make`` reads the data (first path) and writes to a folder (second path). ``endings`` are
    appended to the name.
    """

    make: Callable[[Path, Path], None]
    endings: tuple[str, ...]


FIGURES: Mapping[str, PaperFigure] = {
    "p1-fig1": PaperFigure(p1_stages.fig1, (".jpg",)),
    "p1-fig2": PaperFigure(p1_stages.fig2, (".csv", ".jpg")),
    "p1-fig3": PaperFigure(p1_stages.fig3, (".csv", ".jpg")),
    "p1-fig4": PaperFigure(p1_stages.fig4, ("a.png", "b.jpg")),
    "p1-fig5": PaperFigure(p1_stages.fig5, (".jpg",)),
    "p1-table1": PaperFigure(p1.table1, (".csv",)),
    "p1-table2": PaperFigure(p1.table2, (".csv",)),
    "p2-fig1": PaperFigure(p2_layout.fig1, (".jpg",)),
    "p2-fig2": PaperFigure(p2_layout.fig2, (".jpg",)),
    "p2-fig4b": PaperFigure(p2_layout.fig4b, (".csv", ".png")),
    "p2-fig4c": PaperFigure(p2_layout.fig4c, (".csv", ".png")),
    "p2-fig5": PaperFigure(p2_layout.fig5, (".jpg",)),
    "p2-fig6a": PaperFigure(p2_road.fig6a, (".csv", "-camvid.png")),
    "p2-fig6b": PaperFigure(p2_road.fig6b, (".csv",)),
    "p2-fig7": PaperFigure(p2_road.fig7, (".jpg",)),
    "p2-fig8": PaperFigure(p2_road.fig8, (".jpg",)),
    "p3-fig1": PaperFigure(p3_area.fig1, (".jpg",)),
    "p3-fig2": PaperFigure(p3_area.fig2, (".jpg",)),
    "p3-fig3": PaperFigure(p3_area.fig3, (".csv", "a.jpg", ".png")),
    "p3-fig4": PaperFigure(p3_area.fig4, (".csv", ".jpg", ".png")),
    "p3-fig7": PaperFigure(p3_page.fig7, (".png",)),
    "p3-fig8": PaperFigure(p3_table3.fig8, (".png",)),
    "p3-fig9": PaperFigure(p3_table3.fig9, ("a.png", "b.png")),
    "p3-table3": PaperFigure(p3_table3.table3, (".csv",)),
}
