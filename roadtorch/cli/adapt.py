"""roadtorch adapt: fine-tune the network of fusion on unlabelled footage."""

import shlex
from pathlib import Path

import click

from roadtorch.cli.options import (
    FOOTAGE_ARGUMENT,
    PATH,
    QUIET_OPTION,
    SETTING_OPTION,
    THREADS_OPTION,
    CheckedCommand,
    command_line,
)

ADAPT_CONFIG = "adapt"


@click.command(cls=CheckedCommand)
@FOOTAGE_ARGUMENT
@click.option("--out", type=PATH, required=True, help="Folder of this run; run again to resume.")
@click.option(
    "--limit",
    type=click.IntRange(min=2),
    default=400,
    help="Sample at most this many frames, in groups of five 0.4 s apart if the footage is long; "
    "60 suffice for a first verdict.",
)
@SETTING_OPTION
@THREADS_OPTION
@QUIET_OPTION
@click.pass_context
def adapt_command(
    context: click.Context,
    footage: tuple[str, ...],
    out: Path,
    limit: int,
    assignments: tuple[str, ...],
    threads: int | None,
    quiet: bool,
) -> None:
    """Fine-tune the network of fusion on unlabelled footage, and report whether it helped.

    FOOTAGE: images, folders, quoted globs, videos or bags; some minutes of one camera. Each half
    of the frames trains a network that is compared with the teacher's labels of the other half; the
    last line says adopt, do not adopt, or cannot tell, and why.

    \b
    Written to the folder --out:
      weights.safetensors  weights for infer --set weights.file=OUT/weights.safetensors
      camera.toml          ego car and horizon for infer --camera, if the footage shows them
      adaptation.html      masks before and after
      frames/, labels/     sampled frames, and the teacher's labels of each
      prepared/            the labels, averaged over neighbouring frames
      first/, second/      the training run of each half
    """
    import torch

    from roadtorch.base.errors import ConfigError
    from roadtorch.base.settings import find_config, merge, parse_assignments, read_settings_file
    from roadtorch.train.adaptation.adapt import adapt
    from roadtorch.train.comparison_page import write_page
    from roadtorch.train.config import ImageTraining, build_training
    from roadtorch.train.run import TrainingRequest
    from roadtorch.train.run_folder import ADAPTATION_PAGE

    if threads:
        torch.set_num_threads(threads)
    values = merge(read_settings_file(find_config(ADAPT_CONFIG)), parse_assignments(assignments))
    training = build_training(values)
    if not isinstance(training, ImageTraining) or training.is_new:
        message = "adaptation starts from the weights of a whole-image network"
        hint = "keep kind = images, and give initial_weights=WEIGHTS"
        raise ConfigError("kind, initial_weights", message, hint)
    adaptation = adapt(footage, out, training, limit, quiet)
    outcome, verdict, frames = adaptation.outcome, str(adaptation.verdict), adaptation.frames
    if outcome.interrupted:
        text = f"stopped by {outcome.interrupted.name}; run the same command again to resume"
        click.echo(f"roadtorch: {text}", err=True)
        context.exit(128 + outcome.interrupted)
    request = TrainingRequest(frames.glob(), out, quiet=quiet)
    camera = ["--camera", str(adaptation.camera)] if adaptation.camera else []
    words = ["--set", f"weights.file={outcome.weights}", *camera, "--out", str(out / "roads")]
    is_adopted = adaptation.verdict is not None and adaptation.verdict.word == "adopt"
    use = f"roadtorch infer FOOTAGE {shlex.join(words)}" if is_adopted else ""
    page = write_page(training, request, outcome, verdict, command_line(context), use)
    files = [outcome.weights, adaptation.camera, None if page is None else out / ADAPTATION_PAGE]
    lines = [*frames.skipped, *adaptation.missing]
    if not quiet:
        lines += [f"wrote {file}" for file in files if file]
        lines += [f"to use it: {use}"] if use else []
    for line in lines:
        click.echo(f"roadtorch: {line}", err=True)
    click.echo(verdict)
    context.exit(1 if frames.skipped or outcome.skipped else 0)
