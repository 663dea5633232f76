"""Figures and tables of P3. See scripts/figures.py."""

from collections.abc import Callable, Mapping
from pathlib import Path

from scripts import figures_p3_area, figures_p3_data, figures_p3_light, figures_p3_table3

FIGURES: Mapping[str, Callable[[Path, Path], None]] = {
    **figures_p3_light.FIGURES,
    **figures_p3_area.FIGURES,
    **figures_p3_data.FIGURES,
    **figures_p3_table3.FIGURES,
}
