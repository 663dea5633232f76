"""Networks as files that run without Python: their pre- and post-processing is inside."""
