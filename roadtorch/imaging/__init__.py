"""Image processing: colour planes, resizing, superpixels, thresholds, optical flow."""
