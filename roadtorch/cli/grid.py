"""roadtorch grid: the road in images and footage as metric maps of the ground."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.options import (
    CAMERA,
    INPUTS,
    PATH,
    DetectorOptions,
    Sectioned,
    as_toml,
    with_detector,
    with_run,
    with_selection,
)

if TYPE_CHECKING:
    from roadtorch.inputs.item import Selection
    from roadtorch.run.plan import RunOptions


def _place(_: click.Context, __: click.Parameter, value: str) -> tuple[float, float]:
    """The two numbers of ``X,Y``."""
    from math import isfinite

    from roadtorch.base.errors import ConfigError

    try:
        x, y = map(float, value.split(","))
    except ValueError:
        x = y = float("nan")
    if not (isfinite(x) and isfinite(y)):
        raise ConfigError("--mount", f"{value!r} was given", "give X,Y in metres, as 0.3,0")
    return x, y


@click.command(cls=Sectioned)
@INPUTS
@click.option("--out", type=PATH, required=True, help="Folder for the grids.")
@click.option("--height", type=float, help="Height of the camera above the ground, in metres.")
@click.option(
    "--pitch", type=float, help="Pitch in degrees; positive looks down. [from the layout]"
)
@click.option(
    "--roll",
    type=float,
    default=0.0,
    show_default=False,
    help="Roll in degrees; positive: the right side is lower. [0]",
)
@click.option("--fov", type=float, help="What the camera sees from side to side, degrees.")
@click.option("--camera-info", type=PATH, help="ROS camera_info as YAML, with its distortion.")
@click.option("--calibration", type=PATH, help="KITTI's calibration file; it has the height.")
@CAMERA
@click.option(
    "--mount",
    default="0,0",
    show_default=False,
    callback=_place,
    help="X,Y of the camera on the robot.",
)
@click.option("--resolution", type=float, default=0.1, help="Metres a cell.")
@click.option("--range", type=float, default=30.0, help="Metres ahead.")
@click.option("--side", type=float, default=15.0, help="Metres left and right.")
@with_detector
@click.option("--threshold", type=float, help="Likelihood from which a pixel is road.")
@click.option("--likelihood", is_flag=True, help="Also write NAME.grid.likelihood.npy.")
@click.option("--image", is_flag=True, help="Also write NAME.grid.jpg, to look at.")
@with_selection
@click.option("--frame-id", default="base_link", help="Frame of the robot in bags of grids.")
@with_run
@click.pass_context
def grid(
    context: click.Context,
    inputs: tuple[str, ...],
    out: Path,
    camera: Path | None,
    choice: DetectorOptions,
    threshold: float | None,
    likelihood: bool,
    image: bool,
    selection: "Selection",
    frame_id: str,
    run: "RunOptions",
    **mounting: Any,
) -> None:
    """Map the road in images and footage onto flat ground: x forward, y left (REP 103).

    \b
    Each image NAME.jpg gives, in the folder --out,
      NAME.grid.pgm, NAME.grid.yaml   as Nav2's map_server loads them
      NAME.grid.npy                   int8: 0 free, 100 no road, -1 unknown
    Footage, as infer takes it, gives these for each frame, NAME/000123.grid.pgm, and a bag also
    the bag NAME.grid (of ROS 1: NAME.grid.bag) with /segmentation/grid. The camera's height is
    needed, its lens (--fov, --camera-info or --calibration; a bag's camera_info else), and its
    pitch; without --pitch and --camera that is estimated in each image, to 1 or 2 degrees, or
    once for all frames of a video or bag.
    What lies behind the first cell that is no road is unknown.
    """
    from roadtorch.base.settings import build_settings
    from roadtorch.camera.ground_grid import GridSettings
    from roadtorch.camera.mounting import Mounting, placing_of
    from roadtorch.inputs.find import select_inputs
    from roadtorch.run.ledger import Method
    from roadtorch.run.loop import Inference, Task
    from roadtorch.run.memo import key_of
    from roadtorch.run.plan import plan
    from roadtorch.run.run import open_run
    from roadtorch.run.workers import settle
    from roadtorch.run.writers.choice import GridOutput, is_from_bag
    from roadtorch.run.writers.grid import Grids

    settle(threads=1)
    found = select_inputs(inputs, selection, out)
    cells = {name: mounting.pop(name) for name in ("resolution", "range", "side")}
    of_bags = not found.images and all(map(is_from_bag, found.sources))
    placing = placing_of(Mounting(camera=camera, **mounting), of_bags)
    detector, known = choice.loaded(camera, threshold)
    settings = build_settings(GridSettings, {**cells, "threshold": detector.settings.threshold})
    kinds = ("pgm", "yaml", "npy", *["likelihood"] * likelihood, *["image"] * image)
    inference = Inference(detector, known)
    grids = Grids(out, placing, settings, kinds, frame_id=frame_id)
    todo = plan(found, out, grids.suffixes, GridOutput(grids, inference, selection.topic))
    effective = as_toml(detector.name, detector.settings)
    effective = "\n".join([effective, f"# {settings.model_dump_json()}", placing.words])
    own = context.with_resource(open_run(out, effective, todo.count, run))
    key = key_of(detector, effective)
    method, of_footage = Method(key, kinds), Method(key_of(key, selection, frame_id), ())
    context.exit(own.all(todo, Task(inference, grids, method), of_footage))
