"""Render path-traced worlds with their truth.

    python -m train.worlds FIRST LAST --out WORLDS        (with bpy 5.0.1; opencv-python-headless)
    python -m train.worlds 0 48 --out WORLDS --sheet sheet.jpg      (what is there, truth drawn in)

writes WORLDS/images/NUMBER_KIND_HOUR.jpg and WORLDS/truth/….png (0 sky, 1 vertical, 2 horizontal
without road, 3 road, 4 ego car, 255 void), WORLDS/lenses/….toml of fisheyes, and a row in
WORLDS/worlds.csv. What is there is kept; a number gives the same image. Several at a time:
``--every 2 --from 1`` takes every second number. Numbers from 10000 on are towns, from 12000 on
roads with shoulders and ramps, from 14000 on trails in woods, from 20000 on places without any
road, from 30000 on all of them and people, lenses and mounts by turns (train.worlds.plans), from
40000 on towns above all. The last thousand of each ten thousand teaches no network.

    python -m train.worlds 5000 5012 --out DRIVES --frames 60

drives through each world, a metre a frame: DRIVES/NUMBER_KIND_HOUR/images/FRAME.jpg and
masks/FRAME.png (255 road, 0 not, 128 uncertain), a set that ``roadtorch evaluate folder`` scores;
a fisheye's lens is in lens.toml.
"""

import argparse
import os
import time
from pathlib import Path
from random import Random
from typing import Any

os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"  # before cv2

import cv2
import numpy as np

from train.worlds.blender import bpy
from train.worlds.camera import build_camera, drive_on
from train.worlds.course import BEHIND, START
from train.worlds.furniture import furnish_town
from train.worlds.lens import image_circle, write_lens
from train.worlds.light import build_light, sample_hour, sample_weather
from train.worlds.materials import Nodes
from train.worlds.nowhere import build_nowhere
from train.worlds.plans import FISHEYES, HELD_OUT, NOWHERE, plan_world
from train.worlds.roads import Road, build_road
from train.worlds.sensor import Look, develop
from train.worlds.stage import Stage
from train.worlds.surroundings import build_surroundings
from train.worlds.towns import build_town
from train.worlds.truth import COLOURS, EGO, HORIZONTAL, ROAD, SKY, VOID, settle_truth
from train.worlds.vehicles import build_traffic

SEASONS = {"green": 6, "dry": 3, "earth": 2, "litter": 3, "snow": 2}
"""Of the land, and how often each is sampled."""

SAMPLES = 2
"""Paths a pixel; the rest is the denoiser's."""

FINE = 3
"""Paths through each pixel of the truth, across and down."""

TONES = {SKY: (255, 160, 60), ROAD: (0, 255, 0), EGO: (0, 0, 255), HORIZONTAL: (0, 200, 255)}
TONES[VOID] = (255, 0, 255)
"""Of the truth on a sheet, BGR."""


def build_world(number: int, photographs: Path | None = None) -> tuple[Stage, Road | None, str]:
    """Build the scene of a number; return it, its road, and its name.

    photographs: a folder of them for its materials.
    """
    plan, at = plan_world(number), Random(number)
    stage = Stage(at, photographs)
    stage.around = plan.mount in FISHEYES
    stage.station = START + BEHIND * stage.around
    hour = sample_hour(stage, plan.hours)
    if NOWHERE in plan.kinds:
        build_light(stage, hour)
        return stage, None, f"{number:05d}_{build_nowhere(stage)}_{hour}"
    kind = at.choices(list(plan.kinds), list(plan.kinds.values()))[0]
    season = at.choices(list(SEASONS), list(SEASONS.values()))[0]
    if kind == "town" or plan.wet is not None:
        sample_weather(stage, plan.wet)
    build_light(stage, hour)
    if kind == "town":
        stage.hand = plan.hand
        road, street = build_town(stage, season)
        furnish_town(stage, road, street, plan.crowd)
    else:
        road = build_road(stage, kind, season)
        build_surroundings(stage, road, plan.crowd)
        build_traffic(stage, road)
    build_camera(stage, road, plan.mount)
    return stage, road, f"{number:05d}_{plan.name or kind}_{hour}"


def render(stage: Stage, number: int, place: Path) -> np.ndarray:
    """Render linear light float32 (384, 512, 3) BGR."""
    scene, cycles = stage.scene, stage.scene.cycles
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    cycles.samples, cycles.seed, cycles.max_bounces = SAMPLES, number, 3
    cycles.diffuse_bounces, cycles.glossy_bounces = 1, 2
    cycles.use_light_tree = stage.night  # many lamps; by day it costs a third
    cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
    cycles.denoising_prefilter = "FAST"  # a fifth of the time less
    cycles.sample_clamp_indirect = 10.0
    scene.render.image_settings.file_format = "OPEN_EXR"
    return _written(scene, place / f"light{os.getpid()}.exr")


def render_truth(stage: Stage, place: Path) -> np.ndarray:
    """Render what each pixel is, uint8 (384, 512): flat colours, several paths through each pixel.

    The scene has no light any more afterwards.
    """
    scene, cycles = stage.scene, stage.scene.cycles
    nodes = Nodes(bpy.data.materials.new("truth"))
    colour = nodes.add("ShaderNodeObjectInfo", {}, "Color")
    light = nodes.add("ShaderNodeEmission", {"Color": colour})
    nodes.add("ShaderNodeOutputMaterial", {"Surface": light})
    scene.view_layers[0].material_override = nodes.owner
    for thing in scene.objects:
        thing.hide_render = thing.type == "LIGHT"  # what only the truth shows was hidden before
    scene.world = None
    scene.render.resolution_percentage = 100 * FINE
    cycles.samples, cycles.use_denoising, cycles.max_bounces = 1, False, 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
    shown = _written(scene, place / f"truth{os.getpid()}.exr")[..., ::-1] > 0.5
    scene.render.resolution_percentage = 100
    codes = np.zeros(shown.shape[:2], np.uint8)
    for code, colour in COLOURS.items():
        codes[(shown == np.array(colour, bool)).all(2)] = code
    return settle_truth(codes, FINE)


def _written(scene: Any, file: Path) -> np.ndarray:
    scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    seen = np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))[..., :3].astype(np.float32)
    file.unlink()
    return seen


def develop_world(stage: Stage, number: int, light: np.ndarray, place: Path, file: Path) -> Look:
    """Render the truth to some light, and write the image that the camera makes of it."""
    at = np.random.default_rng([35, number])
    circle = image_circle(stage.lens) if stage.lens else None
    truth = render_truth(stage, place)
    look = develop(light, truth, stage.hour, at, stage.falling, circle)
    cv2.imwrite(str(file), look.image, [cv2.IMWRITE_JPEG_QUALITY, look.quality])
    return look


def make(number: int, out: Path, photographs: Path | None = None) -> str:
    """Render one world; return its name."""
    stage, _, name = build_world(number, photographs)
    light = render(stage, number, out)
    part = out / f"part{os.getpid()}.jpg"
    look = develop_world(stage, number, light, out, part)
    cv2.imwrite(str(out / "truth" / f"{name}.png"), look.truth)
    if stage.lens:
        (out / "lenses" / f"{name}.toml").write_text(write_lens(stage.lens, stage.mount))
    note_world(out / "worlds.csv", name, stage)
    part.rename(out / "images" / f"{name}.jpg")  # last, so that an image has its truth
    return name


def note_world(table: Path, name: str, stage: Stage) -> None:
    """Append a row of a world's properties to a table, which gets its header first."""
    number, kind, hour = name.split("_")
    side = {1: "right", -1: "left"}.get(stage.hand, "")
    held_out = int(number) % 10000 >= HELD_OUT
    row = {"name": name, "kind": kind, "hour": hour, "traffic": side, "held_out": int(held_out)}
    with table.open("a") as file:
        header = "" if file.tell() else ",".join(row) + "\n"
        file.write(header + ",".join(map(str, row.values())) + "\n")


def make_drive(number: int, out: Path, frames: int) -> str:
    """Render frames of a drive through a world, those that are not there yet; return its name."""
    stage, road, name = build_world(number)
    images, masks = (out / name / kind for kind in ("images", "masks"))
    images.mkdir(parents=True, exist_ok=True)
    masks.mkdir(exist_ok=True)
    if road is None:
        raise SystemExit(f"{number}: there is no road to drive on")
    if stage.lens:
        (out / name / "lens.toml").write_text(write_lens(stage.lens, stage.mount))
    steps = drive_on(stage, road, frames)
    files = {frame: images / f"{frame:03d}.jpg" for frame in range(frames)}
    lights = {}
    for frame in [frame for frame, file in files.items() if not file.exists()]:
        steps(frame)
        lights[frame] = render(stage, number, out)
    for frame, light in lights.items():
        steps(frame)
        look = develop_world(stage, number, light, out, files[frame])
        mask = np.where(look.truth == ROAD, 255, np.where(look.truth == VOID, 128, 0))
        cv2.imwrite(str(masks / f"{frame:03d}.png"), mask.astype(np.uint8))
    return name


def sheet(out: Path, first: int, last: int, columns: int = 8) -> np.ndarray:
    """Return images side by side, road green and ego car red in a copy beside each."""
    tiles = []
    for file in sorted((out / "images").glob("*.jpg")):
        if first <= int(file.name[:5]) < last:
            known = str(out / "truth" / f"{file.stem}.png")
            truth = np.asarray(cv2.imread(known, cv2.IMREAD_UNCHANGED))
            image = np.asarray(cv2.imread(str(file)))
            drawn = image.copy()
            for what, tone in TONES.items():
                drawn[truth == what] = drawn[truth == what] * 0.55 + np.array(tone) * 0.45
            cv2.putText(drawn, file.stem, (4, 14), 0, 0.45, (255, 255, 255), 1)
            tiles.append(np.concatenate([image, drawn], 0))
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[k : k + columns], 1) for k in range(0, len(tiles), columns)]
    return np.concatenate(rows, 0)


def main() -> None:
    """Render numbers, or draw a sheet of them."""
    parser = argparse.ArgumentParser(description="Render path-traced worlds with their truth.")
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int, help="the number after the last")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--from", type=int, default=0, dest="offset")
    parser.add_argument("--frames", type=int, help="of a drive through each world")
    parser.add_argument("--sheet", type=Path)
    parser.add_argument("--photographs", type=Path, help="a folder of them for materials")
    given = parser.parse_args()
    if given.sheet:
        cv2.imwrite(str(given.sheet), sheet(given.out, given.first, given.last))
        return
    if not given.frames:
        for name in ("images", "truth", "lenses"):
            (given.out / name).mkdir(parents=True, exist_ok=True)
    for number in range(given.first + given.offset, given.last, given.every):
        if given.frames:
            print(make_drive(number, given.out, given.frames), flush=True)
        elif not any((given.out / "images").glob(f"{number:05d}_*.jpg")):
            begun = time.monotonic()
            print(
                make(number, given.out, given.photographs),
                f"{time.monotonic() - begun:.1f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
