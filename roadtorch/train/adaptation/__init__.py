"""Adaptation of a whole-image network to footage, and the verdict on it."""
