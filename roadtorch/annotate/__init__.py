"""The page for correcting machine labels, and the live view of footage."""
