"""Properties of a camera: lens, pose over the ground, horizon, ego car."""
