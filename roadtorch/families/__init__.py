"""The detectors that come with roadtorch: settings, and how the parts make a detector."""

from roadtorch.detectors import Entry
from roadtorch.families import fused, layout, oneclass, priors, texture, ufl

ENTRIES: tuple[Entry, ...] = (
    *fused.ENTRIES,
    *layout.ENTRIES,
    *texture.ENTRIES,
    *ufl.ENTRIES,
    *oneclass.ENTRIES,
    *priors.ENTRIES,
)
"""All detectors of this package."""
