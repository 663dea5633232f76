"""Path-traced worlds with exact truth: roads, towns, plazas, yards and trails, by many cameras.

``python -m train.worlds --help`` renders them with Blender's module (bpy 5.0.1, Python 3.11), which
only this recipe needs. A world is sampled from its number alone, as a product of parts: ground,
sides, figures and vehicles, light, weather, camera and the vehicle that carries it.
"""
