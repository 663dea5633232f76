"""Writers of detections: maps, videos, bags, ground grids, layout labels, polygons."""
