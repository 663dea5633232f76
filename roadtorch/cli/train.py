"""roadtorch train: a layout network from unlabelled footage."""

from pathlib import Path

import click

from roadtorch.cli.options import PATH, SETTING, ConfigFile, command_line


@click.command()
@click.option(
    "--config",
    type=ConfigFile(),
    required=True,
    help="What is trained, and how: a TOML file, or a shipped one's name, such as adapt.",
)
@click.option(
    "--images", type=click.Path(), required=True, help="Folder, file or quoted glob of images."
)
@click.option(
    "--out", type=PATH, required=True, help="Folder of this run; a second run resumes it."
)
@click.option("--corrections", type=PATH, help="What roadtorch annotate kept: it counts as truth.")
@click.option("--corrected-images", type=PATH, help="Folder of the corrected images, if it moved.")
@SETTING
@click.option(
    "--prepared",
    type=PATH,
    help="Where labelled images are kept, for several runs. [OUT/prepared]",
)
@click.option("--threads", type=click.IntRange(min=1), help="Threads; the result depends on it.")
@click.option("--quiet", is_flag=True, help="No progress, only what goes wrong.")
@click.pass_context
def train(
    context: click.Context,
    config: Path,
    images: str,
    out: Path,
    corrections: Path | None,
    corrected_images: Path | None,
    assignments: tuple[str, ...],
    prepared: Path | None,
    threads: int | None,
    quiet: bool,
) -> None:
    """Train a layout network on machine labels of images that nobody labelled.

    With --corrections, what people said of some of them counts as truth; then the weights and
    the card beside them say so, and what they find is not label-free.

    \b
    The folder --out gets
      weights.safetensors  the network; also after an interruption, as far as it is
      log.csv, curve.png   the error of each epoch
      images.csv           which images were used, and why others were not
      checkpoint.pt        how far it is; Ctrl-C and SIGTERM leave one
      prepared/            small copies of the images with their labels, made once
      weights.md           with --corrections: the card that says so
      adaptation.html      with start in the config: images, trust, agreement before and after
    """
    import torch

    from roadtorch.base.settings import merge, parse_assignments, read_settings_file
    from roadtorch.data.corrections import read_corrections
    from roadtorch.train.before_after import write_page
    from roadtorch.train.config import build_training
    from roadtorch.train.folder import PAGE
    from roadtorch.train.run import Request
    from roadtorch.train.run import train as run

    if threads:
        torch.set_num_threads(threads)
    training = build_training(merge(read_settings_file(config), parse_assignments(assignments)))
    people = read_corrections(corrections, corrected_images) if corrections else []
    request = Request(images, out, prepared, quiet, people)
    outcome = run(training, request)
    if outcome.interrupted:
        signal = outcome.interrupted.name
        text = f"roadtorch: stopped by {signal}; run the same command again to resume"
        click.echo(text, err=True)
        context.exit(128 + outcome.interrupted)
    if not quiet:
        skipped = f"; {outcome.skipped} skipped, see images.csv" if outcome.skipped else ""
        click.echo(f"roadtorch: weights in {outcome.weights}{skipped}", err=True)
    if training.start:
        is_written = write_page(training, request, outcome, command=command_line(context))
        if is_written and not quiet:
            click.echo(f"roadtorch: before and after in {out / PAGE}", err=True)
    context.exit(1 if outcome.skipped else 0)
