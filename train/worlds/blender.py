"""Blender's module, imported as on a machine of one processor.

It starts as many threads as processors are allowed when it is imported, and those that have nothing
to do spin: a world took 8.7 seconds of processors so, 3.1 without.
"""

import os
from importlib import import_module
from typing import Any


def _import_on_one_processor(name: str) -> Any:
    """Import a module while one processor is allowed, where the system can say so."""
    if not hasattr(os, "sched_setaffinity"):
        return import_module(name)
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        return import_module(name)
    finally:
        os.sched_setaffinity(0, allowed)


bpy: Any = _import_on_one_processor("bpy")
mathutils: Any = import_module("mathutils")  # bpy brings it
Matrix, Vector, noise = mathutils.Matrix, mathutils.Vector, mathutils.noise
