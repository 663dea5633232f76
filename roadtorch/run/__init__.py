"""Resumable runs over images and footage: engines, index, records."""
