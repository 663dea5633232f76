"""Export of detectors as files that run without Python, with pre- and post-processing inside."""
