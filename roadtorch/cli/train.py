"""roadtorch train: train a layout network on unlabelled footage."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import (
    PATH,
    QUIET_OPTION,
    ROAD_OPTION,
    SETTING_OPTION,
    THREADS_OPTION,
    VOID_OPTION,
    CheckedCommand,
    ConfigFile,
    command_line,
)

if TYPE_CHECKING:
    from roadtorch.data.corrections import HumanLabels


@click.command(cls=CheckedCommand)
@click.option(
    "--config",
    type=ConfigFile(),
    help="TOML file of the training, or the name of a shipped one, such as adapt; by default "
    "masks with --masks, corrections with --corrections.",
)
@click.option(
    "--images",
    type=click.Path(),
    required=True,
    help="Training images: a folder, file or quoted glob.",
)
@click.option(
    "--source",
    type=PATH,
    multiple=True,
    help="Folder of rendered worlds with truth, for --config fusion; may be repeated.",
)
@click.option("--out", type=PATH, required=True, help="Folder of this run; run again to resume.")
@click.option("--masks", type=PATH, help="Masks of road: a folder of images, or a COCO file.")
@ROAD_OPTION
@VOID_OPTION
@click.option("--corrections", type=PATH, help="Folder of corrections by roadtorch annotate.")
@click.option("--corrected-images", type=PATH, help="Folder of the corrected images, if it moved.")
@SETTING_OPTION
@THREADS_OPTION
@click.option("--device", default="cpu", help="torch device: cpu, cuda, cuda:1.")
@QUIET_OPTION
@click.pass_context
def train_command(
    context: click.Context,
    config: Path | None,
    images: str,
    source: tuple[Path, ...],
    out: Path,
    masks: Path | None,
    road: tuple[str, ...],
    void: tuple[str, ...],
    corrections: Path | None,
    corrected_images: Path | None,
    assignments: tuple[str, ...],
    threads: int | None,
    device: str,
    quiet: bool,
) -> None:
    """Train a layout network on machine labels of unlabelled images.

    With --masks, or --corrections, labels by hand are the truth where they exist, and images
    without them keep their machine labels; the weights and their card record that, and the network
    is not label-free. A tenth of the masks is held out; it decides when to stop and scores the
    result.

    With --config fusion and --source, the network of `fusion` is made in one run: it learns from
    the renderer's truth, then also from the images, which it labels itself, in several rounds.

    \b
    Written to the folder --out:
      weights.safetensors  the network; after an interruption, as trained so far
      log.csv, curve.png   loss of each epoch
      images.csv           images that were used, and why others were not
      checkpoint.pt        state to resume from; also written on Ctrl-C and SIGTERM
      prepared/            small copies of the images with their machine labels
      weights.md           with labels by hand or --source: card of the weights
      sheet-N.jpg          with --source: road in some images after each round
      adaptation.html      with labels by hand or initial_weights: masks, F, trust before and after
    """
    import torch

    from roadtorch.base.errors import ConfigError
    from roadtorch.base.settings import find_config, merge, parse_assignments, read_settings_file
    from roadtorch.data.corrections import read_corrections
    from roadtorch.train.comparison_page import write_page
    from roadtorch.train.config import ImageTraining, SelfTraining, build_training
    from roadtorch.train.run import TrainingRequest, train
    from roadtorch.train.run_folder import ADAPTATION_PAGE

    if threads:
        torch.set_num_threads(threads)
    if masks and corrections:
        raise ConfigError("--masks", "is given with --corrections", "leave one of them out")
    if not (config or masks or corrections):
        raise ConfigError("--config", "is missing", "give it, or --masks, or --corrections")
    path = config or find_config("masks" if masks else "corrections")
    training = build_training(merge(read_settings_file(path), parse_assignments(assignments)))
    corrected: Sequence[HumanLabels] = ()
    if corrections:
        corrected = read_corrections(corrections, corrected_images)
    if masks:
        corrected, summary = read_masks_of_images(masks, images, out, road, void)
        if not quiet:
            click.echo(f"roadtorch: {summary}", err=True)
    command = command_line(context)
    request = TrainingRequest(
        images, out, None, quiet, corrected, source=source, device=device, command=command
    )
    outcome = train(training, request)
    if outcome.interrupted:
        text = f"stopped by {outcome.interrupted.name}; run the same command again to resume"
        click.echo(f"roadtorch: {text}", err=True)
        context.exit(128 + outcome.interrupted)
    if not quiet:
        skipped = f"; {outcome.skipped} skipped, see images.csv" if outcome.skipped else ""
        click.echo(f"roadtorch: weights in {outcome.weights}{skipped}", err=True)
    if (corrected or not training.is_new) and not isinstance(training, SelfTraining):
        weights, roads = f"weights.file={outcome.weights}", str(out / "roads")
        words = ["roadtorch", "infer", images, "--set", weights, "--out", roads]
        use = shlex.join(words) if corrected and isinstance(training, ImageTraining) else ""
        verdict = write_page(training, request, outcome, command=command, use=use)
        if verdict is not None and not quiet:
            lines = [f"masks before and after in {out / ADAPTATION_PAGE}", verdict]
            for line in filter(None, [*lines, use and f"to use it: {use}"]):
                click.echo(f"roadtorch: {line}", err=True)
    context.exit(1 if outcome.skipped else 0)


def read_masks_of_images(
    masks: Path, images: str, out: Path, road: Sequence[str], void: Sequence[str]
) -> "tuple[Sequence[HumanLabels], str]":
    """Read the masks of --images, and what they hold in words; ConfigError if they lie there."""
    from roadtorch.base.errors import ConfigError
    from roadtorch.data.masks import read_masks
    from roadtorch.inputs.images import find_images
    from roadtorch.train.prepared import image_file_name

    if Path(images).is_dir() and masks.resolve().is_relative_to(Path(images).resolve()):
        hint = "give the folder of the images alone, or a quoted glob"
        raise ConfigError(masks, f"lies in --images {images}", hint)
    files = {image_file_name(item): item.path for item in find_images([images], exclude=out)}
    return read_masks(masks, files, road, void)
