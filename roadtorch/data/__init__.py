"""Labelled sets of street pictures: what they are, where their files lie, what labels mean."""
