"""Detectors of roadtorch, and the catalogue that finds them by name."""
