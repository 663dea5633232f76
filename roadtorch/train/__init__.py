"""Training of layout networks on machine labels."""
