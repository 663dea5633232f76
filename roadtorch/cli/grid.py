"""roadtorch grid: the road in pictures and footage as metric maps of the ground."""

from pathlib import Path

import click

from roadtorch.cli.options import (
    CAMERA,
    JOBS,
    OVERWRITE,
    PATH,
    QUIET,
    Choice,
    with_choice,
    with_cut,
)
from roadtorch.cli.suggestions import suggest_files
from roadtorch.runs.options import FrameSelection


def _place(_: click.Context, __: click.Parameter, value: str) -> tuple[float, float]:
    """The two numbers of ``X,Y``."""
    from math import isfinite

    from roadtorch.errors import ConfigError

    try:
        x, y = map(float, value.split(","))
    except ValueError:
        x = y = float("nan")
    if not (isfinite(x) and isfinite(y)):
        raise ConfigError("--mount", f"{value!r} was given", "give X,Y in metres, as 0.3,0")
    return x, y


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, shell_complete=suggest_files)
@click.option("--out", type=PATH, required=True, help="Folder for the grids.")
@click.option("--height", type=float, help="Height of the camera above the ground, in metres.")
@click.option(
    "--pitch", type=float, help="Pitch in degrees; positive looks down. [from the layout]"
)
@click.option(
    "--roll",
    type=float,
    default=0.0,
    help="Roll in degrees; positive: the right side is lower. [0]",
)
@click.option("--fov", type=float, help="What the camera sees from side to side, degrees.")
@click.option("--camera-info", type=PATH, help="ROS camera_info as YAML, with its distortion.")
@click.option("--calibration", type=PATH, help="KITTI's calibration file; it has the height.")
@CAMERA
@click.option("--mount", default="0,0", callback=_place, help="X,Y of the camera on the robot.")
@click.option("--resolution", type=float, default=0.1, show_default=True, help="Metres a cell.")
@click.option("--range", "ahead", type=float, default=30.0, show_default=True, help="Metres ahead.")
@click.option("--side", type=float, default=15.0, show_default=True, help="Metres left and right.")
@click.option(
    "--coarsest", type=float, default=10.0, show_default=True, help="Most cells a pixel may cover."
)
@with_choice
@click.option("--threshold", type=float, help="Likelihood from which a pixel is road.")
@click.option("--likelihood", is_flag=True, help="Also write NAME.grid.likelihood.npy.")
@click.option("--picture", is_flag=True, help="Also write NAME.grid.jpg, to look at.")
@with_cut
@click.option(
    "--frame-id",
    default="base_link",
    show_default=True,
    help="Frame of the robot in bags of grids.",
)
@JOBS
@OVERWRITE
@QUIET
@click.pass_context
def grid(
    context: click.Context,
    inputs: tuple[str, ...],
    out: Path,
    height: float | None,
    pitch: float | None,
    roll: float,
    fov: float | None,
    camera_info: Path | None,
    calibration: Path | None,
    camera: Path | None,
    mount: tuple[float, float],
    resolution: float,
    ahead: float,
    side: float,
    coarsest: float,
    choice: Choice,
    threshold: float | None,
    likelihood: bool,
    picture: bool,
    cut: FrameSelection,
    frame_id: str,
    jobs: int,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Map the road in pictures and footage onto flat ground: x forward, y left (REP 103).

    \b
    Each picture NAME.jpg gives, in the folder --out,
      NAME.grid.pgm, NAME.grid.yaml   as Nav2's map_server loads them
      NAME.grid.npy                   int8: 0 free, 100 no road, -1 unknown
    Footage, as infer takes it, gives these for each frame, NAME/000123.grid.pgm, and a bag also
    the bag NAME.grid (of ROS 1: NAME.grid.bag) with /segmentation/grid. The camera's height is
    needed, its lens (--fov, --camera-info or --calibration; a bag's camera_info else), and its
    pitch; without --pitch and --camera that is estimated in each picture, to 1 or 2 degrees, or
    once for all frames of a video or bag.
    What lies behind the first cell that is no road is unknown.
    """
    from roadtorch.camera.camera import Camera
    from roadtorch.camera.ground_grid import GridSettings
    from roadtorch.cli import config as configuration
    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.runs import batch, engines, footage, footage_grids, grids, results
    from roadtorch.runs.claim import claimed
    from roadtorch.settings import build_settings
    from roadtorch.sources.open import sort_inputs

    sorted_inputs = sort_inputs(inputs)
    given = grids.Mounting(height, pitch, roll, mount, fov, camera_info, calibration, camera)
    placing, words = footage_grids.placing_of_all(given, sorted_inputs)
    name, values = choice.named(threshold)
    known = None if camera is None else Camera.read(camera)
    loaded = load_detector(name, camera=known, **values)
    cells = {"resolution": resolution, "range": ahead, "side": side, "coarsest": coarsest}
    settings = build_settings(GridSettings, {**cells, "threshold": loaded.settings.threshold})
    kinds = ("pgm", "yaml", "npy", *["likelihood"] * likelihood, *["picture"] * picture)
    suffixes = {kind: grids.SUFFIXES[kind] for kind in kinds}
    pictures = batch.plan(sorted_inputs.pictures, out, suffixes, engines.selection(cut))
    check = None if known is None else known.check
    written = footage_grids.FootageGrids(
        loaded, settings, kinds, placing, given, check, cut.topic, frame_id
    )
    sources = engines.footage_of(sorted_inputs.sources, str(out), cut)
    planned = footage.plan_sources(sources, out, written)
    context.with_resource(claimed(out))
    effective = configuration.as_toml(loaded.name, loaded.settings)
    effective = "\n".join([effective, f"# {settings.model_dump_json()}", words])
    results.keep_config(out, effective, overwrite)
    options = batch.Options(jobs, overwrite, quiet)
    codes = [0]
    if pictures and placing is not None:
        method = results.detector_method(loaded, effective, kinds)
        gridding = grids.Gridding(loaded, placing, settings, frozenset(kinds), known)
        codes.append(batch.run_jobs(pictures, out, gridding, method, options))
    if planned:
        parts = repr((cut, frame_id)).encode()
        method = results.detector_method(loaded, effective, (), parts)
        work = footage.FootageWork(loaded, written, check, footage.steadied)
        codes.append(footage.run_sources(planned, work, method, options))
    context.exit(max(codes))
