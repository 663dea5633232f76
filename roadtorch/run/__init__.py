"""Resumable runs over images and footage: workers, index.csv, run.json, writers."""
