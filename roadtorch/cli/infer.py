"""roadtorch infer: write likelihoods, masks and overlays of images and footage."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import (
    CAMERA_OPTION,
    FOOTAGE_KINDS,
    INPUTS_ARGUMENT,
    PATH,
    DetectorOptions,
    SectionedCommand,
    command_line,
    computing_options,
    detector_options,
    refuse_unused,
    selection_options,
)

if TYPE_CHECKING:
    from roadtorch.annotate.viewer import Viewer
    from roadtorch.inputs.item import Selection
    from roadtorch.run.plan import RunOptions

GRID_KINDS = ("grid", "grid-likelihood", "grid-image")
RESULT_KINDS = ("likelihood", "mask", "overlay", "cues", "npy", "polygons", "json", *GRID_KINDS)


def _parse_kinds(
    _: click.Context, __: click.Parameter, value: str | None
) -> tuple[str, ...] | None:
    """Parse a comma-separated list of kinds of results, into the order of RESULT_KINDS."""
    from roadtorch.base.errors import ConfigError, unknown_name_error

    if value is None:
        return None
    requested = [kind.strip() for kind in value.split(",") if kind.strip()]
    choices = (*RESULT_KINDS, *FOOTAGE_KINDS)
    for kind in requested:
        if kind not in choices:
            raise unknown_name_error("kind of result", kind, choices)
    if not requested:
        raise ConfigError("--save", "nothing to save", f"give some of {', '.join(choices)}")
    return tuple(kind for kind in choices if kind in requested)


def make_viewer() -> "Viewer":
    """Return the page that shows footage, and print its address; ConfigError without its extra."""
    from roadtorch.base.errors import ConfigError

    try:
        from roadtorch.annotate.viewer import Viewer
    except ImportError:
        hint = "pip install 'roadtorch[annotate]'"
        raise ConfigError("--view", "needs Starlette and uvicorn", hint) from None
    viewer = Viewer()
    click.echo(f"Open {viewer.address.url}  (press Ctrl-C to stop)")
    return viewer


@click.command(cls=SectionedCommand)
@INPUTS_ARGUMENT
@detector_options
@click.option("--out", type=PATH, default="roads", help="Folder for results.")
@click.option(
    "--save",
    callback=_parse_kinds,
    help=f"Results to write: some of {','.join(RESULT_KINDS)}; for footage also "
    f"{','.join(FOOTAGE_KINDS)}. [likelihood,mask,overlay; for footage overlay, for bags "
    "overlay,bag]",
)
@selection_options
@click.option(
    "--smoothing/--no-smoothing", default=True, help="Smooth the likelihood of footage over time."
)
@click.option("--view", is_flag=True, help="Show footage live on a local page.")
@CAMERA_OPTION
@click.option("--threshold", type=float, help="Likelihood from which a pixel is road.")
@click.option(
    "--depth", type=click.Choice(["8", "16"]), default="8", help="Bits of likelihood maps."
)
@computing_options
@click.pass_context
def infer_command(
    context: click.Context,
    inputs: tuple[str, ...],
    choice: DetectorOptions,
    out: Path,
    save: tuple[str, ...] | None,
    selection: "Selection",
    smoothing: bool,
    view: bool,
    camera_file: Path | None,
    threshold: float | None,
    depth: str,
    options: "RunOptions",
) -> None:
    """Find the road in images, videos, cameras, streams and bags.

    \b
    INPUT is a file, a folder (with its subfolders), a quoted glob, a camera (0
    or camera:0), a stream (rtsp://, http://), an image by http, a ROS bag, - for
    names on standard input, or @list.txt. For each image NAME.jpg, in the
    folder --out:
      NAME.likelihood.png   road likelihood, 0 black to 1 white
      NAME.mask.png         road white, the rest black
      NAME.overlay.jpg      the image with road tinted and outlined
    and on demand NAME.cue.CUE.png (--save cues), .npy files, outlines (--save
    polygons: NAME.coco.json and coco.json), NAME.json, and the ground in metres
    (--save grid, grid-likelihood, grid-image: NAME.grid.pgm, .yaml, .npy and
    so on), which needs the height and lens of the camera (--set grid.height=1.4
    --set grid.fov=60, or the file of --camera). For each video
    NAME.mp4: NAME.overlay.mp4, and on demand these files for each frame,
    NAME/000123.mask.png. For each bag: NAME.overlay.mp4 and the bag NAME.road
    (of ROS 1: NAME.road.bag). index.csv lists every image and frame, run.json
    records the command, the settings and the environment. Run the same
    command again to resume: what is done is skipped, and footage that was
    interrupted starts again with its first frame.
    """
    from roadtorch.base.settings import to_toml
    from roadtorch.camera.mounting import build_placement
    from roadtorch.inputs.find import Inputs, find_inputs
    from roadtorch.layout.runtimes import check_runtime
    from roadtorch.run.ledger import COCO_FILE, RUN_FILE
    from roadtorch.run.loop import Inference, Task
    from roadtorch.run.memo import cache_key
    from roadtorch.run.plan import plan_run
    from roadtorch.run.record import record_run
    from roadtorch.run.run import open_run
    from roadtorch.run.workers import configure_threads
    from roadtorch.run.writers.coco import write_coco
    from roadtorch.run.writers.grid import GridWriter
    from roadtorch.run.writers.maps import MapWriter
    from roadtorch.run.writers.outputs import DEFAULT_IMAGE_KINDS, MapOutput, is_from_bag

    configure_threads(options.device)
    check_runtime(choice.runtime, options.device)
    choice, grid_values = choice.split("grid")
    detector, camera = choice.load(camera_file, threshold, options.device)
    effective = to_toml(detector.name, detector.settings)
    images, sources = find_inputs(inputs, selection, out)
    kinds = DEFAULT_IMAGE_KINDS if save is None else save
    without_images = sources and set(kinds) <= set(FOOTAGE_KINDS)  # nothing is written of them
    selected = Inputs([] if without_images else selection.select_images(images), sources)
    has_grid = not set(kinds).isdisjoint(GRID_KINDS)
    refuse_unused(
        context,
        footage=bool(selected.sources),
        bag=any(map(is_from_bag, selected.sources)),
        likelihood="likelihood" in kinds and bool(selected.images or save),
        grid=has_grid,
    )
    bits = 16 if depth == "16" else 8
    inference, level = Inference(detector, camera), detector.settings.threshold
    maps = MapWriter(out, frozenset(kinds), detector.name, level, bits)
    key = detector, depth, options.device
    if has_grid:
        only_bags = not selected.images and all(map(is_from_bag, selected.sources))
        placement = build_placement(camera, grid_values, only_bags)
        maps = replace(maps, grids=GridWriter(placement, level))
        effective, key = f"{effective}\n{placement.as_comment()}", (*key, placement)
    viewer = context.with_resource(make_viewer()) if view else None
    outputs = MapOutput(maps, inference, save, selection.topic, viewer)
    files = [RUN_FILE, *[COCO_FILE] * ("polygons" in kinds)]
    todo = plan_run(selected, out, maps.suffixes, outputs, files)
    footage_options = {**asdict(selection), "smoothing": smoothing}
    task = Task(inference, maps, cache_key(*key), kinds)
    recorded_options = {**asdict(options), **footage_options, "save": kinds, "depth": bits}
    recorded = (detector, todo.row_names, recorded_options, command_line(context))
    with open_run(out, effective, todo, options) as run, record_run(run.ledger, *recorded):
        try:
            code = run.process(todo, task, cache_key(task.key, footage_options), smoothing)
        finally:
            if "polygons" in kinds:
                write_coco(out, run.ledger.rows.values())
    context.exit(code)
