"""How far off the free boundary of a grid is, in metres, against its distance.

    python scripts/grid_error.py walls           # exact masks of walls at known distances
    python scripts/grid_error.py streets --count 24   # rendered streets, true mask and detector
    python scripts/grid_error.py horizon --count 24   # the pitch that pictures tell

Walls: a road 6 m wide that ends at a wall, seen by a pinhole 1.4 m above it, 480×360 pixels, 60
degrees, pitched down by 5; rendered by its own ray casting, without the code under test. Streets:
``roadtorch.scenes.street``; the boundary of the true mask with the true pitch is the truth there. A
pitch error is what the grid is told too much (+) or too little (-).
"""

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from roadtorch import load_detector
from roadtorch.camera.ground import GroundCamera, Lens, lens_of_view, mounted, pitch_of_horizon
from roadtorch.camera.ground_grid import GridSettings, Rays, ground_rays
from roadtorch.camera.horizon import horizon_of
from roadtorch.errors import InputError
from roadtorch.runs.grids import decided
from roadtorch.scenes.canvas import CAMERA_HEIGHT
from roadtorch.scenes.street import draw_street, render_scene

DISTANCES = (5, 10, 15, 20, 30)
ERRORS = (0.0, 1.0, -1.0, 2.0, -2.0)
HEIGHT, PITCH, WIDTH, ROWS, VIEW = 1.4, 5.0, 480, 360, 60.0
CELLS = GridSettings(range=60, side=15, coarsest=1000)
NEAR = 0.15  # share of a distance within which a boundary counts to it


def wall_mask(distance: float) -> Tensor:
    """What is road bool (360,480) before a wall: each pixel's ray, met with ground and wall."""
    focal = WIDTH / 2 / math.tan(math.radians(VIEW) / 2)
    right, down = np.meshgrid(
        (np.arange(WIDTH) + 0.5 - WIDTH / 2) / focal, (np.arange(ROWS) + 0.5 - ROWS / 2) / focal
    )
    sine, cosine = math.sin(math.radians(PITCH)), math.cos(math.radians(PITCH))
    ahead, fall = cosine - down * sine, sine + down * cosine
    scale = np.where(fall > 0, HEIGHT / np.where(fall > 0, fall, 1), np.inf)
    road = (fall > 0) & (scale * ahead < distance) & (np.abs(scale * right) < 3)
    return torch.from_numpy(road)


def walls() -> None:
    lens = lens_of_view(WIDTH, ROWS, VIEW)
    print("wall at  " + "".join(f"{f'{error:+.0f}°':>16}" for error in ERRORS))
    for distance in DISTANCES:
        cells = []
        for error in ERRORS:
            camera = GroundCamera(lens, mounted(HEIGHT, PITCH + error))
            rays = ground_rays(wall_mask(distance), camera, CELLS)
            middle = (rays.azimuth.sin() * rays.free).abs() < min(2.0, distance * 0.4)
            ends = rays.free * rays.azimuth.cos()
            found = ends[middle & rays.free.isfinite()]
            angle = math.atan(HEIGHT / distance) + math.radians(error)
            expected = HEIGHT / math.tan(angle) - distance if angle > 0 else math.inf
            told = f"{float(found.median()) - distance:+.2f}" if len(found) else "none"
            cells.append(f"{told} ({expected:+.2f})")
        print(f"{distance:4d} m   " + "".join(f"{cell:>16}" for cell in cells))
    print("median over the rays that end at the wall, metres; in brackets what geometry expects")


def street_cameras(count: int) -> Iterator[tuple[int, Lens, float]]:
    """Seeds, lenses and heights of the horizon (share) of rendered streets, 480×360."""
    for seed in range(100, 100 + count):
        horizon = draw_street(np.random.default_rng(seed)).horizon
        focal = 0.95 * max(WIDTH, ROWS * 4 / 3)
        lens = Lens(
            width=WIDTH,
            height=ROWS,
            focal_x=focal,
            focal_y=focal,
            centre_x=WIDTH / 2 - 0.5,
            centre_y=horizon * ROWS - 0.5,
        )
        yield seed, lens, horizon


def streets(count: int, name: str) -> None:
    detector = load_detector(name)
    threshold = detector.settings.threshold
    settings = {"mask": CELLS, "found": CELLS.model_copy(update={"threshold": threshold})}
    off: dict[tuple[str, float], list[Tensor]] = {}
    for seed, lens, _ in street_cameras(count):
        scene = render_scene(seed, ROWS, WIDTH)
        detection = detector.detect(scene.image)
        maps = {"mask": scene.road, "found": decided(detection, threshold)}
        level = GroundCamera(lens, mounted(CAMERA_HEIGHT, 0.0))
        truth = ground_rays(scene.road, level, CELLS)
        for kind, road in maps.items():
            for error in ERRORS:
                camera = GroundCamera(lens, mounted(CAMERA_HEIGHT, error))
                rays = ground_rays(road, camera, settings[kind])
                found = _off(truth, rays)
                off.setdefault((kind, error), []).append(found)
    table = {key: torch.cat(pairs, 1) for key, pairs in off.items()}
    for kind, title in (("mask", "true mask"), ("found", name)):
        print(f"{title}\n  at     rays" + "".join(f"{f'{error:+.0f}°':>20}" for error in ERRORS))
        for distance in DISTANCES:
            cells = [_spread(table[kind, error], distance) for error in ERRORS]
            true = table[kind, 0.0][0]
            number = int(((true - distance).abs() <= NEAR * distance).sum())
            print(f"{distance:4d} m {number:6d}" + "".join(f"{cell:>20}" for cell in cells))
    print("median error along the rays, in brackets how far the boundary is from the nearest")
    print("point of the true one, median; metres; rays that never end are left out")


def _off(truth: Rays, rays: Rays) -> Tensor:
    """For rays (B,) that truly end: where, by how much ours ends elsewhere, and how near the
    true boundary that is: (3,B) metres."""
    ended = truth.free.isfinite()
    nearest = (truth.azimuth[:, None] - rays.azimuth).abs().argmin(1)
    free = rays.free[nearest]
    ours, true = (
        torch.stack([away * truth.azimuth.cos(), away * truth.azimuth.sin()], 1)
        for away in (free, truth.free)
    )
    apart = torch.cdist(ours.nan_to_num(posinf=1e6), true[ended]).amin(1)
    return torch.stack([truth.free, free - truth.free, apart])[:, ended]


def _spread(found: Tensor, distance: float) -> str:
    rays = found[:, ((found[0] - distance).abs() <= NEAR * distance) & found[1].isfinite()]
    if not rays.shape[1]:
        return "none"
    return f"{float(rays[1].median()):+.2f} ({float(rays[2].median()):.2f})"


def horizon(count: int, name: str) -> None:
    detector = load_detector(name)
    wrong, refused, covered = [], 0, 0
    for seed, lens, row in street_cameras(count):
        image = render_scene(seed, ROWS, WIDTH).image
        try:
            found = horizon_of(image, detector.detect(image).cues["layout"])
        except InputError as problem:
            print(f"scene {seed}: {problem.what}")
            refused += 1
            continue
        wrong.append(pitch_of_horizon(lens, found.row) - pitch_of_horizon(lens, row))
        covered += abs(found.row - row) <= found.spread
    size = np.abs(wrong)
    print(
        f"{count} scenes, {refused} refused: mean {np.mean(wrong):+.2f}°, "
        f"median size {np.median(size):.2f}°, 90 % up to {np.quantile(size, 0.9):.2f}°, "
        f"worst {size.max():.2f}°; within its own spread {covered} of {len(wrong)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["walls", "streets", "horizon"])
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--detector", default="fusion")
    given = parser.parse_args()
    if given.what == "walls":
        walls()
    elif given.what == "streets":
        streets(given.count, given.detector)
    else:
        horizon(given.count, given.detector)


if __name__ == "__main__":
    main()
