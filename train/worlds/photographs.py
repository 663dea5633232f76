"""Photographs of ground, walls and skies as materials of the worlds, if a folder of them is given.

The folder has KIND/NAME_color.jpg, sky/NAME.exr and sources.csv (file, …, width_m). They are
sampled with a generator of their own, so that a number's shapes are the same without them.
"""

import csv
import re
from functools import cache
from math import exp, pi
from pathlib import Path
from typing import Any, NamedTuple

import bpy
import cv2
import numpy as np

from train.worlds.stage import Stage

FILES = {
    "asphalt": r"asphalt/",
    "cobbles": r"paving/(PavingStones0[135]|brick|cobble|ec_|floor_p|stone_f|omr_ch|volc)",
    "slabs": r"paving/(Tiles|anti_skid|blue|brown|hexa|long|pavement|PavingStones072)",
    "concrete": r"paving/(Concrete|anti_slip|brushed|concrete|cracked|gd_c|gravel|hangar|omr_con)",
    "earth": r"soil/(Gravel|Ground0(06|11|33|7|8|9)|aerial_ground|brown_mud|coast_sand_02|damp|dry"
    r"|ec_dirt|ec_sand_|river|t3d_(road|sand))",
    "litter": r"soil/(Ground0(23|42|48)|burned|coast_sand_rocks|forrest|leaves|mud_forest)",
    "grass": r"grass/",
    "snow": r"snow/(Snow006|ec_|snow_tracks|t3d)",
    "wall": r"wall/(Bricks|Plaster|beige|brick|broken|castle|concrete|omr_bric|osm_putz|osm_gab"
    r"|plast|brown_pl|beam)",
}
"""Files of each kind, by the beginnings of their names in the folder."""

ORIGINAL, DETAIL = 0.45, 0.35
"""Probabilities that a material has a photograph's colours, or its detail on sampled colours."""

HARD = ("asphalt", "concrete", "cobbles", "slabs")
"""Kinds whose colours are desaturated."""

SKIES = {
    "sun": "hilly_terrain_01 kloppenheim_05 kloppenheim_06_puresky pm_sky sunflowers_puresky"
    " rooitou_park",
    "dusk": "kloppenheim_06_puresky spruit_sunrise kiara_1_dawn venice_sunset",
    "overcast": "aristea_wreck_puresky kloppenheim_06_puresky noon_grass",
    "night": "dikhololo_night moonless_golf narrow_moonlit_road",
}
"""Skies by time of day."""


class Photograph(NamedTuple):
    """A photograph; wide: metres of a tile, 0 if unknown; mean: its mean colour, linear RGB."""

    file: Path
    wide: float
    mean: tuple[float, ...]


@cache
def list_photographs(folder: Path, kind: str) -> list[Photograph]:
    """List all square photographs of a kind."""
    with (folder / "sources.csv").open(encoding="utf-8", newline="") as file:
        widths = {row["file"]: row["width_m"].split(" ")[0] for row in csv.DictReader(file)}
    photographs = []
    for file in sorted(folder.glob("*/*_color.jpg")):
        name = str(file.relative_to(folder))
        image = np.asarray(cv2.imread(str(file))) if re.match(FILES[kind], name) else None
        if image is not None and 0.8 < image.shape[0] / image.shape[1] < 1.25:
            mean = ((image[..., ::-1] / 255.0) ** 2.2).mean((0, 1)) + 0.005
            wide = widths.get(name, "")
            known = float(wide) if re.fullmatch(r"\d+(\.\d+)?", wide) else 0.0
            photographs.append(Photograph(file, known, tuple(mean)))
    return photographs


def lay_photograph(stage: Stage, nodes: Any, kind: str, look: Any, plain: Any = None) -> Any:
    """Texture a procedural surface with a photograph; without one return it, or ``plain``."""
    at, otherwise = stage.pick, look if plain is None else plain
    if not (stage.photographs and kind):
        return otherwise
    if kind == "asphalt" and at.random() < 0.15:
        kind = "concrete"
    share = at.random()
    file, wide, mean = at.choice(list_photographs(stage.photographs, kind))
    if share > ORIGINAL + DETAIL:
        return otherwise
    photo = _tile(stage, nodes, file, kind, wide * exp(at.gauss(0, 0.2)) or at.uniform(1.2, 3.5))
    if share < ORIGINAL:
        grey = at.uniform(0.2, 0.9) if kind in HARD else at.uniform(0.6, 1.1)
        photo = nodes.add("ShaderNodeHueSaturation", {"Color": photo, "Saturation": grey})
        gain = exp(at.gauss(0, 0.25)) * min(1.0, 0.75 / max(mean))
        tint = [gain * exp(at.gauss(0, 0.05)) for _ in range(3)]
        patch = at.uniform(0.7, 1)
        patches = nodes.step(nodes.noise(at.uniform(0.05, 0.4)), 0.3, 0.7)
        under = nodes.mix(patches, tuple(c * patch for c in tint), tuple(tint))
    else:
        parts = [1 / max(c, 0.02) for c in mean]
        under = nodes.add("ShaderNodeVectorMath", {0: look, 1: parts}, operation="MULTIPLY")
    photo = nodes.add("ShaderNodeVectorMath", {0: photo, 1: under}, operation="MULTIPLY")
    return nodes.add("ShaderNodeVectorMath", {0: photo, 1: (0.92,) * 3}, operation="MINIMUM")


def _tile(stage: Stage, nodes: Any, file: Path, kind: str, wide: float) -> Any:
    """Repeat a photograph in two blended layers, which hides its tiling."""
    at, strict, wall = stage.pick, kind in ("cobbles", "slabs"), kind == "wall"
    turn = 0.0 if wall else at.choice([0, pi / 2]) if strict else at.uniform(0, 2 * pi)
    image = bpy.data.images.load(str(file), check_existing=True)
    where = nodes.add("ShaderNodeTexCoord", {}, "Object") if wall else nodes.place()
    layers = []
    for second in (False, True):
        spin = turn + second * (not strict and not wall) * at.uniform(1, 5)
        options = {"Vector": where, "Rotation": (0, 0, spin), "Scale": (1 / wide,) * 3}
        options["Location"] = tuple(at.uniform(-50, 50) for _ in range(3))
        mapped = nodes.add("ShaderNodeMapping", options)
        more = {"image": image, "projection": "BOX", "projection_blend": 0.0 if wall else 0.2}
        layers.append(nodes.add("ShaderNodeTexImage", {"Vector": mapped}, **more))
    soft = 0.01 if strict or wall else 0.08
    share = nodes.step(nodes.noise(at.uniform(0.15, 0.5), 2), 0.5 - soft, 0.5 + soft)
    return nodes.mix(share, *layers)


def lay_sky(stage: Stage, nodes: Any) -> tuple[Any, float] | None:
    """Return a photographed sky and its strength, in a third of the worlds."""
    if not stage.photographs or stage.pick.random() > 1 / 3:
        return None
    file = stage.photographs / "sky" / f"{stage.pick.choice(SKIES[stage.hour].split())}.exr"
    light = np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))[..., :3]
    bright = float(np.minimum(light[: len(light) // 2], 8).mean())
    turn = (0, 0, stage.pick.uniform(0, 2 * pi))
    where = nodes.add("ShaderNodeTexCoord", {}, "Generated")
    where = nodes.add("ShaderNodeMapping", {"Vector": where, "Rotation": turn})
    image = bpy.data.images.load(str(file), check_existing=True)
    nodes.owner.cycles.sample_map_resolution = light.shape[1]  # less would miss the sun
    look = nodes.add("ShaderNodeTexEnvironment", {"Vector": where}, image=image)
    aim = stage.haze.colour[1] * stage.pick.uniform(0.8, 1.5)
    return look, aim / bright
