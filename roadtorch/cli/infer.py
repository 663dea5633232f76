"""roadtorch infer: images to likelihoods, masks and overlays."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import (
    CAMERA,
    INPUTS,
    PATH,
    DetectorOptions,
    Sectioned,
    as_toml,
    command_line,
    with_computing,
    with_detector,
    with_selection,
)

if TYPE_CHECKING:
    from roadtorch.annotate.viewer import Viewer
    from roadtorch.inputs.item import Selection
    from roadtorch.run.plan import RunOptions

KINDS = ("likelihood", "mask", "overlay", "cues", "npy", "polygons", "json")
FOOTAGE_KINDS = ("overlay-frames", "mask-video", "likelihood-video", "bag")


def _kinds(_: click.Context, __: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    """The kinds of results in a comma-separated list, each once, in the order of KINDS."""
    from roadtorch.base.errors import ConfigError, unknown_name

    if value is None:
        return None
    asked = [kind.strip() for kind in value.split(",") if kind.strip()]
    known = (*KINDS, *FOOTAGE_KINDS)
    for kind in asked:
        if kind not in known:
            raise unknown_name("kind of result", kind, known)
    if not asked:
        raise ConfigError("--save", "nothing to save", f"name some of {', '.join(known)}")
    return tuple(kind for kind in known if kind in asked)


def opened_viewer() -> "Viewer":
    """The page that shows footage, its address printed; ConfigError where its extra is missing."""
    from roadtorch.base.errors import ConfigError

    try:
        from roadtorch.annotate.viewer import Viewer
    except ImportError:
        hint = "pip install 'roadtorch[annotate]'"
        raise ConfigError("--view", "needs Starlette and uvicorn", hint) from None
    viewer = Viewer()
    click.echo(f"Open {viewer.address.url}  (Ctrl-C ends it)")
    return viewer


@click.command(cls=Sectioned)
@INPUTS
@with_detector
@click.option("--out", type=PATH, default="roads", help="Folder for results.")
@click.option(
    "--save",
    callback=_kinds,
    help=f"What to write: some of {','.join(KINDS)}; of footage also {','.join(FOOTAGE_KINDS)}. "
    "[likelihood,mask,overlay; of footage overlay, of bags overlay,bag]",
)
@with_selection
@click.option(
    "--steady/--no-steady",
    default=True,
    help="In footage, smooth the likelihood over time.",
)
@click.option("--view", is_flag=True, help="Show footage live on a local page.")
@CAMERA
@click.option("--threshold", type=float, help="Likelihood from which a pixel is road.")
@click.option(
    "--depth", type=click.Choice(["8", "16"]), default="8", help="Bits of likelihood maps."
)
@with_computing
@click.pass_context
def infer(
    context: click.Context,
    inputs: tuple[str, ...],
    choice: DetectorOptions,
    out: Path,
    save: tuple[str, ...] | None,
    selection: "Selection",
    steady: bool,
    view: bool,
    camera: Path | None,
    threshold: float | None,
    depth: str,
    run: "RunOptions",
) -> None:
    """Find the road in images, videos, cameras, streams and bags.

    \b
    INPUT is a file, a folder (with all below), a quoted glob, a camera (0 or
    camera:0), a stream (rtsp://, http://), an image by http, a ROS bag, - for
    names on standard input, or @list.txt. Each image NAME.jpg gives, in the folder --out,
      NAME.likelihood.png   how road-like each pixel is, 0 to white
      NAME.mask.png         road white, the rest black
      NAME.overlay.jpg      the image with its road tinted and outlined
    and on demand NAME.cue.CUE.png (--save cues), .npy files, outlines (--save
    polygons: NAME.labelme.json and coco.json) and NAME.json. Each video
    NAME.mp4 gives NAME.overlay.mp4, and on demand these files for each frame,
    NAME/000123.mask.png. Each bag gives NAME.overlay.mp4 and the bag NAME.road
    (of ROS 1: NAME.road.bag). index.csv lists every image and frame, run.json
    says how it was made. A second run resumes where the first one stopped.
    """
    from roadtorch.inputs.find import select_inputs
    from roadtorch.run.ledger import Method
    from roadtorch.run.loop import Inference, Task
    from roadtorch.run.memo import key_of
    from roadtorch.run.plan import plan
    from roadtorch.run.record import recorded
    from roadtorch.run.run import open_run
    from roadtorch.run.workers import settle
    from roadtorch.run.writers.choice import OF_IMAGES, MapOutput
    from roadtorch.run.writers.coco import write_coco
    from roadtorch.run.writers.maps import Maps

    settle(run.threads, run.device)
    detector, known = choice.loaded(camera, threshold)
    effective = as_toml(detector.name, detector.settings)
    found = select_inputs(inputs, selection, out)
    kinds = OF_IMAGES if save is None else save
    bits = 16 if depth == "16" else 8
    maps = Maps(out, frozenset(kinds), detector.name, detector.settings.threshold, bits)
    viewer = context.with_resource(opened_viewer()) if view else None
    output = MapOutput(maps, save, selection.topic, viewer)
    todo = plan(found, out, maps.suffixes, output)
    of_frames = {**asdict(selection), "steady": steady}
    key = key_of(detector, depth)
    method, of_footage = Method(key, kinds), Method(key_of(key, of_frames), ())
    task = Task(Inference(detector, known, run.device), maps, method)
    given = {**asdict(run), **of_frames, "save": kinds, "depth": bits}
    record = recorded(out, detector, todo.row_names, given, command_line(context))
    with open_run(out, effective, todo.count, run, record) as own:
        try:
            code = own.all(todo, task, of_footage, steady)
        finally:
            if "polygons" in kinds:
                write_coco(out)
    context.exit(code)
