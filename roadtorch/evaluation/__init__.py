"""Scoring of detectors on labelled images."""
