"""Labelled sets of street images: what they are, where their files lie, what labels mean."""
