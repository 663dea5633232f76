"""Adaptation: fine-tune a network on one's own footage, and judge whether that helped."""
