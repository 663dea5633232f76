"""Around the computation: signals, plug-ins, work shared on one image, shipped configs."""
