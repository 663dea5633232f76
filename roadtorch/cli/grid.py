"""roadtorch grid: map the road in images and footage onto the ground, in metres."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.options import (
    CAMERA_OPTION,
    INPUTS_ARGUMENT,
    PATH,
    DetectorOptions,
    SectionedCommand,
    detector_options,
    refuse_unused,
    run_options,
    selection_options,
)

if TYPE_CHECKING:
    from roadtorch.inputs.item import Selection
    from roadtorch.run.plan import RunOptions


def _parse_mount(_: click.Context, __: click.Parameter, value: str) -> tuple[float, float]:
    """Parse ``X,Y``."""
    from math import isfinite

    from roadtorch.base.errors import ConfigError

    try:
        x, y = map(float, value.split(","))
    except ValueError:
        x = y = float("nan")
    if not (isfinite(x) and isfinite(y)):
        raise ConfigError("--mount", f"{value!r} was given", "give X,Y in metres, such as 0.3,0")
    return x, y


@click.command(cls=SectionedCommand)
@INPUTS_ARGUMENT
@click.option("--out", type=PATH, required=True, help="Folder for the grids.")
@click.option("--height", type=float, help="Height of the camera above the ground, in metres.")
@click.option(
    "--pitch", type=float, help="Pitch in degrees, positive downwards. [estimated from the layout]"
)
@click.option(
    "--roll",
    type=float,
    default=0.0,
    show_default=False,
    help="Roll in degrees, positive if the right side is lower. [0]",
)
@click.option("--fov", type=float, help="Horizontal field of view, in degrees.")
@click.option("--camera-info", type=PATH, help="ROS camera_info as YAML, with distortion.")
@click.option("--calibration", type=PATH, help="KITTI calibration file, with the height.")
@CAMERA_OPTION
@click.option(
    "--mount",
    default="0,0",
    show_default=False,
    callback=_parse_mount,
    help="X,Y of the camera on the robot, in metres. [0,0]",
)
@click.option("--resolution", type=float, default=0.1, help="Size of a cell, in metres.")
@click.option("--range", type=float, default=30.0, help="Extent ahead, in metres.")
@click.option("--side", type=float, default=15.0, help="Extent to each side, in metres.")
@detector_options
@click.option("--threshold", type=float, help="Likelihood from which a pixel is road.")
@click.option("--likelihood", is_flag=True, help="Also write NAME.grid.likelihood.npy.")
@click.option("--image", is_flag=True, help="Also write NAME.grid.jpg, for viewing.")
@selection_options
@click.option("--frame-id", default="base_link", help="TF frame of the robot, for bags.")
@run_options
@click.pass_context
def grid_command(
    context: click.Context,
    inputs: tuple[str, ...],
    out: Path,
    camera_file: Path | None,
    choice: DetectorOptions,
    threshold: float | None,
    likelihood: bool,
    image: bool,
    selection: "Selection",
    frame_id: str,
    options: "RunOptions",
    **mounting: Any,
) -> None:
    """Map the road in images and footage onto flat ground: x forward, y left (REP 103).

    \b
    For each image NAME.jpg, in the folder --out:
      NAME.grid.pgm, NAME.grid.yaml   for Nav2's map_server
      NAME.grid.npy                   int8: 0 free, 100 no road, -1 unknown
    Footage (see infer) gives these for each frame, NAME/000123.grid.pgm; a bag also gives the
    bag NAME.grid (of ROS 1: NAME.grid.bag) with /segmentation/grid. Required are the camera's
    height, its lens (--fov, --camera-info or --calibration; for a bag, its camera_info) and its
    pitch; without --pitch and --camera, pitch is estimated for each image, to 1 or 2 degrees, or
    once for all frames of a video or bag.
    Cells behind the first cell that is no road are unknown.
    """
    from roadtorch.base.settings import build_settings, to_toml
    from roadtorch.camera.ground_grid import GridSettings
    from roadtorch.camera.mounting import Mounting, build_placement
    from roadtorch.inputs.find import select_inputs
    from roadtorch.run.ledger import Method
    from roadtorch.run.loop import Inference, Task
    from roadtorch.run.memo import cache_key
    from roadtorch.run.plan import plan_run
    from roadtorch.run.run import open_run
    from roadtorch.run.workers import configure_threads
    from roadtorch.run.writers.grid import GridWriter
    from roadtorch.run.writers.outputs import GridOutput, is_from_bag

    configure_threads(threads=1)
    selected = select_inputs(inputs, selection, out)
    refuse_unused(context, bag=any(map(is_from_bag, selected.sources)))
    cells = {name: mounting.pop(name) for name in ("resolution", "range", "side")}
    only_bags = not selected.images and all(map(is_from_bag, selected.sources))
    placement = build_placement(Mounting(camera=camera_file, **mounting), only_bags)
    detector, camera = choice.load(camera_file, threshold)
    settings = build_settings(GridSettings, {**cells, "threshold": detector.settings.threshold})
    kinds = ("pgm", "yaml", "npy", *["likelihood"] * likelihood, *["image"] * image)
    inference = Inference(detector, camera)
    grids = GridWriter(out, placement, settings, kinds, frame_id=frame_id)
    todo = plan_run(selected, out, grids.suffixes, GridOutput(grids, inference, selection.topic))
    effective = to_toml(detector.name, detector.settings)
    effective = "\n".join([effective, f"# {settings.model_dump_json()}", placement.as_comment])
    run = context.with_resource(open_run(out, effective, todo, options))
    key = cache_key(detector, effective)
    method, footage_method = Method(key, kinds), Method(cache_key(key, selection, frame_id), ())
    context.exit(run.process(todo, Task(inference, grids, method), footage_method))
