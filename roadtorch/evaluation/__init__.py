"""Scoring detectors on labelled images."""
