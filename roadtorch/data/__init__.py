"""Labelled data sets of street images: their file layouts and the meaning of their labels."""
