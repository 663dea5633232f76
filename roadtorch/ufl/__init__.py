"""Features learned from one image, and hierarchical threshold segmentation (P1)."""
