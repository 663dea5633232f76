"""What belongs to a camera: how its image lies on the ground."""
