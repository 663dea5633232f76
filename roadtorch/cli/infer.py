"""roadtorch infer: pictures to likelihoods, masks and overlays."""

from dataclasses import asdict, replace
from pathlib import Path

import click

from roadtorch.cli.options import (
    CAMERA,
    OVERWRITE,
    QUIET,
    Choice,
    with_choice,
    with_cut,
    with_means,
)
from roadtorch.cli.suggestions import suggest_files
from roadtorch.runs.options import ComputeOptions, FrameSelection

KINDS = ("likelihood", "mask", "overlay", "cues", "npy", "polygons", "json")
FOOTAGE_KINDS = ("overlay-frames", "mask-video", "likelihood-video", "bag")


def _kinds(_: click.Context, __: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    """The kinds of results in a comma-separated list, each once, in the order of KINDS."""
    from roadtorch.errors import ConfigError, unknown_name

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


def _stretch(_: click.Context, __: click.Parameter, value: str | None) -> tuple[float, ...] | None:
    """Start and end of a stretch, in seconds, of START:END."""
    if value is None:
        return None
    from roadtorch.errors import ConfigError
    from roadtorch.sinks.gif import LONGEST

    try:
        start, end = map(float, value.split(":"))
    except ValueError:
        raise ConfigError("--gif", f"{value!r} was given", "give START:END, as 3:6.5") from None
    if not 0 <= start < end <= start + LONGEST:
        remedy = f"give a stretch of at most {LONGEST:g} seconds"
        raise ConfigError("--gif", f"{value!r} is no stretch to show", remedy)
    return start, end


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1, shell_complete=suggest_files)
@with_choice
@click.option("--out", default="roads", show_default=True, help="Folder or URL for results.")
@click.option(
    "--save",
    callback=_kinds,
    help=f"What to write: some of {','.join(KINDS)}; of footage also {','.join(FOOTAGE_KINDS)}. "
    "[likelihood,mask,overlay; of footage overlay, of bags overlay,bag]",
)
@with_cut
@click.option(
    "--steady/--no-steady",
    default=True,
    show_default=True,
    help="In footage, carry what earlier frames said along the motion.",
)
@click.option("--gif", callback=_stretch, metavar="START:END", help="Seconds to show as a GIF.")
@CAMERA
@click.option("--threshold", type=float, help="Likelihood from which a pixel is road.")
@click.option(
    "--depth",
    type=click.Choice(["8", "16"]),
    default="8",
    show_default=True,
    help="Bits of likelihood maps.",
)
@with_means
@OVERWRITE
@QUIET
@click.option("--print-config", is_flag=True, help="Print the effective settings and stop.")
@click.pass_context
def infer(
    context: click.Context,
    inputs: tuple[str, ...],
    choice: Choice,
    out: str,
    save: tuple[str, ...] | None,
    cut: FrameSelection,
    steady: bool,
    gif: tuple[float, float] | None,
    camera: Path | None,
    threshold: float | None,
    depth: str,
    means: ComputeOptions,
    overwrite: bool,
    quiet: bool,
    print_config: bool,
) -> None:
    """Find the road in pictures, videos, cameras, streams, bags and archives.

    \b
    INPUT is a file, a folder (with all below), a quoted glob, a camera (0 or
    camera:0), a stream (rtsp://, http://), a ROS bag, an archive of pictures,
    a URL of fsspec (s3://bucket/drive), - for names on standard input, or
    @list.txt. Each picture NAME.jpg gives, in the folder --out,
      NAME.likelihood.png   how road-like each pixel is, 0 to white
      NAME.mask.png         road white, the rest black
      NAME.overlay.jpg      the picture with its road tinted and outlined
    and on demand NAME.cue.CUE.png (--save cues), .npy files, outlines (--save
    polygons: NAME.labelme.json and coco.json) and NAME.json. Each video
    NAME.mp4 gives NAME.overlay.mp4, and on demand these files for each frame,
    NAME/000123.mask.png. Each bag gives NAME.overlay.mp4 and the bag NAME.road
    (of ROS 1: NAME.road.bag). index.csv lists every picture and frame, run.json
    says how it was made. A second run goes on where the first one stopped.
    """
    from roadtorch.cli import config as configuration

    name, values = choice.named(threshold)
    if not inputs and not print_config:
        raise click.UsageError("Missing argument 'INPUT...'", context)

    from roadtorch.camera.camera import Camera
    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.runs import batch, engines, footage, results
    from roadtorch.runs.footage_results import USUAL_OF_PICTURES, FootageResults
    from roadtorch.runs.run_record import RunRecord
    from roadtorch.sources.open import sort_inputs

    engines.prepare(means)
    known = None if camera is None else Camera.read(camera)
    loaded = load_detector(name, camera=known, **values)
    effective = configuration.as_toml(loaded.name, loaded.settings)
    if print_config:
        click.echo(effective)
        return
    bits = 16 if depth == "16" else 8
    told = sort_inputs(inputs)
    kinds = USUAL_OF_PICTURES if save is None else save
    work = results.Inference(loaded, frozenset(kinds), bits, known, means.device)
    plan = engines.plan_run(told.pictures, out, kinds, work, engines.selection(cut))
    written = FootageResults(save, bits, gif, loaded, cut.topic)
    sources = footage.plan_sources(engines.footage_of(told.sources, out, cut), Path(out), written)
    place = context.with_resource(plan.claimed())
    results.keep_config(place, effective, overwrite)
    plan.publish(place / results.CONFIG)
    files = tuple(job.file for job in [*plan.jobs, *(job for _, job in sources)])
    of_frames = {**asdict(cut), "gif": gif, "steady": steady}
    options = batch.Options(means.jobs or 1, overwrite, quiet, means.fail_fast)

    def of_pictures(engine: batch.Engine | None) -> int:
        method = results.detector_method(loaded, effective, kinds, depth.encode())
        own = replace(options, engine=engine, publish=plan.publish, shown=out)
        return batch.run_jobs(plan.jobs, place, plan.work, method, own)

    def of_footage() -> int:
        parts = repr((depth, of_frames)).encode()
        method = results.detector_method(loaded, effective, (), parts)
        check = None if known is None else known.check
        seen = footage.FootageWork(loaded, written, check, footage.steadied if steady else None)
        return footage.run_sources(sources, seen, method, options)

    def run() -> int:
        try:
            with engines.started(means, len(plan.jobs)) as engine:
                codes = [of_pictures(engine)] if plan.jobs else [0]
            return max([*codes, *([of_footage()] if sources else [])])
        finally:
            plan.assemble(place, kinds)

    given = {**asdict(means), **of_frames, "save": kinds, "depth": bits}
    context.exit(RunRecord(place, loaded, files, given, plan.publish).around(run))
