"""The detectors that come with roadtorch: settings, and how the parts make a detector."""

from roadtorch.detectors import Entry
from roadtorch.families import fused, layout, priors, texture

ENTRIES: tuple[Entry, ...] = (*fused.ENTRIES, *layout.ENTRIES, *texture.ENTRIES, *priors.ENTRIES)
"""All detectors of this package."""
