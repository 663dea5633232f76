"""What belongs to a camera: how its picture lies on the ground."""
