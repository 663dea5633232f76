"""Path-traced worlds with exact truth: roads, towns, yards and tracks, seen by many cameras.

``python -m train.worlds --help`` renders them with Blender's module (bpy 5.0.1, Python 3.11), which
only this recipe needs. A world is sampled from its number alone: kind of road, surroundings,
traffic, light, camera and the car that carries it.
"""
