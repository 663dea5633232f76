"""roadtorch adapt: fine-tune the network of fusion on footage, without labels."""

from pathlib import Path

import click

from roadtorch.cli.options import FOOTAGE, PATH, QUIET, SETTING, command_line

CONFIG = "adapt"


@click.command()
@FOOTAGE
@click.option(
    "--out", type=PATH, required=True, help="Folder of this run; a second run resumes it."
)
@click.option(
    "--frames",
    "most",
    type=click.IntRange(min=2),
    default=400,
    help="Frames to learn from, in stretches of five.",
)
@SETTING
@click.option("--threads", type=click.IntRange(min=1), help="Threads; the result depends on it.")
@QUIET
@click.pass_context
def adapt(
    context: click.Context,
    footage: tuple[str, ...],
    out: Path,
    most: int,
    assignments: tuple[str, ...],
    threads: int | None,
    quiet: bool,
) -> None:
    """Fine-tune the network of fusion on footage, without labels, and report whether it helped.

    FOOTAGE: images, folders, quoted globs, videos, bags; some minutes of one camera. Each half
    of it trains a network that is judged on the other half; the last line says adopt, do not
    adopt, or cannot tell, and why.

    \b
    The folder --out gets
      weights.safetensors  for infer --set weights.file=OUT/weights.safetensors
      camera.toml          what stays the same, for infer --camera; where the footage shows it
      adaptation.html      before and after, on images
      frames/, looks/      the sampled frames, and the teacher's prediction for each
      prepared/            the same, averaged with those of the frames around
      first/, second/      the run of each half
    """
    import torch

    from roadtorch.base.errors import ConfigError
    from roadtorch.base.settings import config_file, merge, parse_assignments, read_settings_file
    from roadtorch.train.adaptation.adapt import adapt as run
    from roadtorch.train.before_after import write_page
    from roadtorch.train.config import ImageTraining, build_training
    from roadtorch.train.folder import PAGE
    from roadtorch.train.run import Request

    if threads:
        torch.set_num_threads(threads)
    values = merge(read_settings_file(config_file(CONFIG)), parse_assignments(assignments))
    training = build_training(values)
    if not isinstance(training, ImageTraining) or not training.start:
        message = "adaptation starts from a network for whole images"
        raise ConfigError("kind, start", message, "leave kind as it is, and give start=WEIGHTS")
    done = run(footage, out, training, most, quiet)
    outcome, verdict, frames = done.outcome, str(done.verdict), done.frames
    if outcome.interrupted:
        signal = outcome.interrupted.name
        text = f"roadtorch: stopped by {signal}; run the same command again to resume"
        click.echo(text, err=True)
        context.exit(128 + outcome.interrupted)
    request = Request(frames.glob(), out, prepared=done.prepared, quiet=quiet)
    command = command_line(context)
    is_written = write_page(training, request, outcome, verdict, command)
    files = [outcome.weights, done.camera, out / PAGE if is_written else None]
    lines = [*frames.skipped, *done.missing]
    if not quiet:
        camera = f" --camera {done.camera}" if done.camera else ""
        use = f"roadtorch infer FOOTAGE --set weights.file={outcome.weights}{camera} --out roads"
        lines += [*(f"wrote {file}" for file in files if file), f"to use it: {use}"]
    for line in lines:
        click.echo(f"roadtorch: {line}", err=True)
    click.echo(verdict)
    context.exit(1 if frames.skipped or outcome.skipped else 0)
