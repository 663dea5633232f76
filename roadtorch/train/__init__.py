"""Training of layout networks on machine labels: ``python -m roadtorch.train``."""
