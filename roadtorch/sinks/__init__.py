"""Where what was found in footage goes: videos, GIFs, bags, grids of the ground."""
