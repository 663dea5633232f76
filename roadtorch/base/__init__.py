"""Errors, settings, signals, bounded reads, atomic writes and image codecs."""
