"""Steps on images: colour, size, exposure, motion."""
