"""Adaptation: a network that goes on learning from one's own footage, and whether it paid."""
