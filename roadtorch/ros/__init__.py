"""A node of ROS 2: images in; masks, confidences, grids and diagnostics out."""
