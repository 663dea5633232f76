"""Resumable runs over pictures and footage: engines, index, records."""
