"""roadtorch compare: two results against each other, with labels, corrections, or neither."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.completion import suggest_candidates, suggest_files
from roadtorch.cli.options import JOBS, PATH, QUIET, command_line

if TYPE_CHECKING:
    from roadtorch.data.dataset import Dataset
    from roadtorch.evaluation.methods import Contender


@click.command()
@click.argument("first", metavar="A", shell_complete=suggest_candidates)
@click.argument("second", metavar="B", shell_complete=suggest_candidates)
@click.option("--labelled", help="A labelled set: NAME:ROOT, as roadtorch evaluate has them.")
@click.option("--corrections", type=PATH, help="What roadtorch annotate kept; it counts as truth.")
@click.option("--pictures", type=PATH, help="Folder of the corrected pictures, if it moved.")
@click.option(
    "--images",
    multiple=True,
    shell_complete=suggest_files,
    help="Folder, file or glob without labels.",
)
@click.option("--out", type=PATH, help="Folder for the page and the figures.")
@click.option("--limit", type=click.IntRange(min=1), help="Look at this many pictures only.")
@click.option(
    "--worst", type=click.IntRange(min=0), default=12, help="Pictures on the page, the worst first."
)
@JOBS
@QUIET
@click.pass_context
def compare(
    context: click.Context,
    first: str,
    second: str,
    labelled: str | None,
    corrections: Path | None,
    pictures: Path | None,
    images: tuple[str, ...],
    out: Path | None,
    limit: int | None,
    worst: int,
    jobs: int,
    quiet: bool,
) -> None:
    """Compare A and B: weights, configs, folders of maps, or detectors, each at its own threshold.

    With --labelled or --corrections: figures with intervals, and the difference of B to A. With
    --images: where they disagree most.
    """
    from roadtorch.data.catalogue import open_named
    from roadtorch.data.corrections import open_corrections
    from roadtorch.evaluation.methods import candidate
    from roadtorch.layout.weights import corrected_pictures
    from roadtorch.run.folder import output_lock
    from roadtorch.run.workers import settle

    if sum((labelled is not None, corrections is not None, bool(images))) != 1:
        raise click.UsageError("give one of --labelled, --corrections and --images")
    settle(threads=1)
    methods = candidate(first, "A"), candidate(second, "B")
    if out is not None:
        context.with_resource(output_lock(out))
    for contender in methods:
        if count := corrected_pictures(contender.settings):
            text = f"{contender.name} was trained with {count} pictures that people corrected: not "
            click.echo(f"roadtorch: {text}label-free, and no news on those pictures", err=True)
    if images:
        code = _disagree(context, methods, images, limit, jobs, quiet)
    elif corrections is not None:
        code = _score(context, methods, open_corrections(corrections, pictures), limit, jobs)
    else:
        code = _score(context, methods, open_named(str(labelled)), limit, jobs)
    context.exit(code)


def _score(
    context: click.Context,
    methods: "Sequence[Contender]",
    dataset: "Dataset",
    limit: int | None,
    jobs: int | None,
) -> int:
    from roadtorch.cli.evaluate import tell_failures
    from roadtorch.evaluation.evaluate import evaluated
    from roadtorch.evaluation.report.tables import screen

    against = methods[0].name
    evaluation = evaluated(dataset, methods, limit=limit, against=against, jobs=jobs, quiet=False)
    click.echo(screen(evaluation))
    tell_failures(evaluation)
    if (out := context.params["out"]) is not None:
        from roadtorch.evaluation.report.files import write

        write(evaluation, out, command_line(context), context.params["worst"])
    return 1 if evaluation.failures else 0


def _disagree(
    context: click.Context,
    methods: "tuple[Contender, Contender]",
    images: Sequence[str],
    limit: int | None,
    jobs: int | None,
    quiet: bool,
) -> int:
    from roadtorch.base.errors import InputError
    from roadtorch.data.dataset import every_kth
    from roadtorch.evaluation.disagreement import disagreements, unlabelled_set
    from roadtorch.evaluation.report.disagreement import disagreement_text, write_disagreement
    from roadtorch.inputs.pictures import find_pictures

    out = context.params["out"]
    dataset = every_kth(unlabelled_set(find_pictures(images, out)), limit)
    seen = disagreements(dataset, methods, jobs, quiet)
    for failure in seen.failures:
        click.echo(f"failed: {failure.image}: {failure.reason}", err=True)
    if not seen.pictures:
        raise InputError(images[0], "has no picture that both could look at", "see above")
    click.echo(disagreement_text(seen))
    if out is not None:
        write_disagreement(out, seen, context.params["worst"], command_line(context))
    return 1 if seen.failures else 0
