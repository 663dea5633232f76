"""Superpixels: SLIC, connectivity, statistics and features of segments."""
