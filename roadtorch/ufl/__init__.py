"""Features learned from the one picture, and hierarchical threshold segmentation (P1)."""
