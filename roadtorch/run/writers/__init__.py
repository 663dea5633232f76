"""Where detections go: maps, videos, GIFs, bags, grids of the ground, labels, outlines."""
