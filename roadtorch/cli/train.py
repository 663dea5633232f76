"""roadtorch train: train a layout network on unlabelled footage."""

from pathlib import Path

import click

from roadtorch.cli.options import PATH, SETTING_OPTION, ConfigFile, command_line


@click.command()
@click.option(
    "--config",
    type=ConfigFile(),
    required=True,
    help="TOML file of the training, or the name of a shipped one, such as adapt.",
)
@click.option(
    "--images",
    type=click.Path(),
    required=True,
    help="Training images: a folder, file or quoted glob.",
)
@click.option("--out", type=PATH, required=True, help="Folder of this run; run again to resume.")
@click.option("--corrections", type=PATH, help="Folder of corrections by roadtorch annotate.")
@click.option("--corrected-images", type=PATH, help="Folder of the corrected images, if it moved.")
@SETTING_OPTION
@click.option(
    "--prepared",
    type=PATH,
    help="Folder of images with machine labels, shared by several runs. [OUT/prepared]",
)
@click.option(
    "--threads", type=click.IntRange(min=1), help="Threads of torch; the result depends on it."
)
@click.option("--quiet", is_flag=True, help="Print only failures, no progress.")
@click.pass_context
def train_command(
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
    """Train a layout network on machine labels of unlabelled images.

    With --corrections, labels corrected by hand are the truth where they exist; the weights and
    their card record that, and the network is not label-free.

    \b
    Written to the folder --out:
      weights.safetensors  the network; after an interruption, as trained so far
      log.csv, curve.png   loss of each epoch
      images.csv           images that were used, and why others were not
      checkpoint.pt        state to resume from; also written on Ctrl-C and SIGTERM
      prepared/            small copies of the images with their machine labels
      weights.md           with --corrections: card of the weights
      adaptation.html      with initial_weights: masks, trust, agreement before and after
    """
    import torch

    from roadtorch.base.settings import merge, parse_assignments, read_settings_file
    from roadtorch.data.corrections import read_corrections
    from roadtorch.train.comparison_page import write_page
    from roadtorch.train.config import build_training
    from roadtorch.train.run import TrainingRequest, train
    from roadtorch.train.run_folder import ADAPTATION_PAGE

    if threads:
        torch.set_num_threads(threads)
    training = build_training(merge(read_settings_file(config), parse_assignments(assignments)))
    corrected = read_corrections(corrections, corrected_images) if corrections else []
    request = TrainingRequest(images, out, prepared, quiet, corrected)
    outcome = train(training, request)
    if outcome.interrupted:
        signal = outcome.interrupted.name
        text = f"roadtorch: stopped by {signal}; run the same command again to resume"
        click.echo(text, err=True)
        context.exit(128 + outcome.interrupted)
    if not quiet:
        skipped = f"; {outcome.skipped} skipped, see images.csv" if outcome.skipped else ""
        click.echo(f"roadtorch: weights in {outcome.weights}{skipped}", err=True)
    if training.initial_weights:
        is_written = write_page(training, request, outcome, command=command_line(context))
        if is_written and not quiet:
            click.echo(f"roadtorch: masks before and after in {out / ADAPTATION_PAGE}", err=True)
    context.exit(1 if outcome.skipped else 0)
