"""Scoring detectors on labelled pictures."""
