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


def _kinds(_: click.Context, __: click.Parameter, value: str) -> tuple[str, ...]:
    """The kinds of results in a comma-separated list, each once, in the order of KINDS."""
    from roadtorch.errors import ConfigError, unknown_name

    asked = [kind.strip() for kind in value.split(",") if kind.strip()]
    for kind in asked:
        if kind not in KINDS:
            raise unknown_name("kind of result", kind, KINDS)
    if not asked:
        raise ConfigError("--save", "nothing to save", f"name some of {', '.join(KINDS)}")
    return tuple(kind for kind in KINDS if kind in asked)


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1)
@ONE_DETECTOR
@click.option("--out", type=PATH, default=Path("roads"), show_default=True, help="Results.")
@click.option(
    "--save",
    default="likelihood,mask,overlay",
    show_default=True,
    callback=_kinds,
    help=f"What to write: some of {','.join(KINDS)}.",
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
    save: tuple[str, ...],
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
    """Find the road in pictures: files, folders (with all below) and quoted globs.

    \b
    Each picture NAME.jpg gives, in the folder --out,
      NAME.likelihood.png   how road-like each pixel is, 0 to white
      NAME.mask.png         road white, the rest black
      NAME.overlay.jpg      the picture with its road tinted and outlined
    and on demand NAME.cue.CUE.png (--save cues) and .npy files. index.csv lists every
    picture. A second run goes on where the first one stopped.
    """
    from roadtorch.cli import config as configuration

    name, values = configuration.chosen_detector(detector, config, assignments, threshold)
    if not inputs and not print_config:
        raise click.UsageError("Missing argument 'INPUT...'", context)

    from roadtorch.camera.camera import Camera
    from roadtorch.cli import batch, results
    from roadtorch.cli.claim import claimed
    from roadtorch.detectors.catalogue import load_detector

    known = None if camera is None else Camera.read(camera)
    loaded = load_detector(name, camera=known, **values)
    effective = configuration.as_toml(loaded.name, loaded.settings)
    if print_config:
        click.echo(effective)
        return
    planned = batch.plan(inputs, out, results.suffixes(save), results.cue_suffixes(save))
    context.with_resource(claimed(out))
    results.keep_config(out, effective, overwrite)
    work = results.Inference(loaded, frozenset(save), 16 if depth == "16" else 8, known)
    method = results.detector_method(loaded, effective, save, depth.encode())
    options = batch.Options(jobs, overwrite, quiet)
    context.exit(batch.run_jobs(planned, out, work, method, options))
