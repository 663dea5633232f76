"""Figures and tables of P2. See scripts/figures.py, and docs/p2.md for what they show."""

from collections.abc import Callable, Mapping
from pathlib import Path

from scripts import figures_p2_layout, figures_p2_road, figures_p2_studies

FIGURES: Mapping[str, Callable[[Path, Path], None]] = {
    "p2-fig4b": figures_p2_layout.confusion_of_cnn7,
    "p2-fig4c": figures_p2_layout.confusion_of_labeller,
    "p2-fig5": figures_p2_layout.layout_sheet,
    "p2-fig6a": figures_p2_road.roc_curves,
    "p2-fig6b": figures_p2_road.road_accuracy,
    "p2-fig7": figures_p2_road.texture_sheet,
    "p2-fig8": figures_p2_road.road_sheet,
    "p2-eq4": figures_p2_studies.priors,
    "p2-ridge": figures_p2_studies.ridges,
    "p2-superpixels": figures_p2_studies.superpixel_counts,
}
"""Figs. 3 and 4a needed training: train/README.md, "Studies in the history"."""
