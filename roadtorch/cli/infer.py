"""roadtorch infer: pictures to likelihoods, masks and overlays."""

from pathlib import Path

import click

from roadtorch.cli.options import (
    CAMERA,
    CONFIG,
    JOBS,
    ONE_DETECTOR,
    OVERWRITE,
    PATH,
    QUIET,
    SETTING,
)

KINDS = ("likelihood", "mask", "overlay", "cues", "npy")
FOOTAGE_KINDS = ("overlay-frames", "mask-video", "likelihood-video")


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
    from roadtorch.errors import ConfigError
    from roadtorch.sinks.gif import LONGEST

    if value is None:
        return None
    try:
        start, end = map(float, value.split(":"))
    except ValueError:
        raise ConfigError("--gif", f"{value!r} was given", "give START:END, as 3:6.5") from None
    if not 0 <= start < end <= start + LONGEST:
        remedy = f"give a stretch of at most {LONGEST:g} seconds"
        raise ConfigError("--gif", f"{value!r} is no stretch to show", remedy)
    return start, end


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1)
@ONE_DETECTOR
@click.option("--out", type=PATH, default=Path("roads"), show_default=True, help="Results.")
@click.option(
    "--save",
    callback=_kinds,
    help=f"What to write: some of {','.join(KINDS)}; of footage also {','.join(FOOTAGE_KINDS)}. "
    "[likelihood,mask,overlay; of footage overlay]",
)
@click.option("--every", type=click.IntRange(min=1), default=1, help="One frame of so many.")
@click.option("--start", type=click.FloatRange(min=0), default=0.0, help="Of footage: seconds.")
@click.option("--end", type=click.FloatRange(min=0), help="Of footage: seconds, left out.")
@click.option("--limit", type=click.IntRange(min=1), help="At most so many frames or pictures.")
@click.option("--topic", help="Of bags: the images to look at, where there are several.")
@click.option("--gif", callback=_stretch, metavar="START:END", help="Seconds to show as a GIF.")
@click.option(
    "--patience",
    type=click.FloatRange(min=0.1),
    default=10.0,
    show_default=True,
    help="Seconds within which a stream has to answer.",
)
@SETTING
@CONFIG
@CAMERA
@click.option("--threshold", type=float, help="Likelihood from which a pixel is road.")
@click.option("--depth", type=click.Choice(["8", "16"]), default="8", show_default=True)
@JOBS
@OVERWRITE
@QUIET
@click.option("--print-config", is_flag=True, help="Print the effective settings and stop.")
@click.pass_context
def infer(
    context: click.Context,
    inputs: tuple[str, ...],
    detector: str | None,
    out: Path,
    save: tuple[str, ...] | None,
    every: int,
    start: float,
    end: float | None,
    limit: int | None,
    topic: str | None,
    gif: tuple[float, float] | None,
    patience: float,
    assignments: tuple[str, ...],
    config: Path | None,
    camera: Path | None,
    threshold: float | None,
    depth: str,
    jobs: int,
    overwrite: bool,
    quiet: bool,
    print_config: bool,
) -> None:
    """Find the road in pictures, videos, cameras and streams.

    \b
    INPUT is a file, a folder (with all below), a quoted glob, a camera (0 or
    camera:0), a stream (rtsp://, http://), - for names on standard input, or
    @list.txt. Each picture NAME.jpg gives, in the folder --out,
      NAME.likelihood.png   how road-like each pixel is, 0 to white
      NAME.mask.png         road white, the rest black
      NAME.overlay.jpg      the picture with its road tinted and outlined
    and on demand NAME.cue.CUE.png (--save cues) and .npy files. Each video
    NAME.mp4 gives NAME.overlay.mp4, and on demand these files for each frame,
    NAME/000123.mask.png. index.csv lists every picture and frame. A second run
    goes on where the first one stopped.
    """
    from roadtorch.cli import config as configuration

    name, values = configuration.chosen_detector(detector, config, assignments, threshold)
    if not inputs and not print_config:
        raise click.UsageError("Missing argument 'INPUT...'", context)

    from roadtorch.camera.camera import Camera
    from roadtorch.cli import batch, footage, results
    from roadtorch.cli.claim import claimed
    from roadtorch.cli.footage_results import USUAL_OF_PICTURES, FootageResults
    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.sources.frame import Selection
    from roadtorch.sources.live import Patience
    from roadtorch.sources.open import Told, open_sources, sort_inputs

    known = None if camera is None else Camera.read(camera)
    loaded = load_detector(name, camera=known, **values)
    effective = configuration.as_toml(loaded.name, loaded.settings)
    if print_config:
        click.echo(effective)
        return
    bits = 16 if depth == "16" else 8
    selection = Selection(every, start, end, limit)
    sorted_inputs = sort_inputs(inputs)
    kinds = USUAL_OF_PICTURES if save is None else save
    pictures = batch.plan(sorted_inputs.pictures, out, results.suffixes(kinds), selection)
    told = Told(out, Patience(answer=patience), topic)
    sources = open_sources(sorted_inputs.sources, selection, told)
    written = FootageResults(save, bits, gif)
    planned = footage.plan_sources(sources, out, written)
    context.with_resource(claimed(out))
    results.keep_config(out, effective, overwrite)
    options = batch.Options(jobs, overwrite, quiet)
    codes = [0]
    if pictures:
        work = results.Inference(loaded, frozenset(kinds), bits, known)
        method = results.detector_method(loaded, effective, kinds, depth.encode())
        codes.append(batch.run_jobs(pictures, out, work, method, options))
    if planned:
        parts = (depth.encode(), repr((selection, gif, topic)).encode())
        method = results.detector_method(loaded, effective, (), *parts)
        # STEADY: steady=partial(Steady, settings), and the settings among the parts above.
        work = footage.FootageWork(loaded, written, None if known is None else known.check)
        codes.append(footage.run_sources(planned, work, method, options))
    context.exit(max(codes))
