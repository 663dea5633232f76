"""The detectors that come with roadtorch, and the catalogue in which all are found by name."""
