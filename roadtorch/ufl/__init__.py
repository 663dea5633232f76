"""Features learned from the one image, and hierarchical threshold segmentation (P1)."""
