"""Figures and tables of P1. See scripts/figures.py."""

from collections.abc import Callable, Mapping
from pathlib import Path

FIGURES: Mapping[str, Callable[[Path, Path], None]] = {}
