"""roadtorch tune: choose a detector's threshold on labelled development pictures."""

from pathlib import Path

import click

from roadtorch.cli.options import PATH, labelled_set


@click.command()
@labelled_set
@click.option("--out", type=PATH, required=True, help="Folder for the configs, NAME.toml.")
@click.pass_context
def tune(
    context: click.Context,
    dataset: str,
    root: Path,
    split: str | None,
    names: tuple[str, ...],
    assignments: tuple[str, ...],
    out: Path,
    left_out: tuple[str, ...],
    limit: int | None,
    jobs: int,
) -> None:
    """Choose thresholds on the labelled pictures of DATASET at ROOT.

    The threshold with the highest F, averaged over the groups, goes into OUT/NAME.toml
    together with the detector's settings and this command; use it with infer --config.
    Shown beside it is how well such a choice carries over: F and IoU of each group at the
    threshold that the other groups choose.
    """
    from roadtorch.cli.config import as_toml
    from roadtorch.cli.labelled import command_line, opened, tell_failures, watched
    from roadtorch.evaluation.evaluate import evaluate
    from roadtorch.evaluation.tally import forget
    from roadtorch.evaluation.thresholds import choose_threshold
    from roadtorch.io.atomic import write_text
    from roadtorch.report.choices import choice_table, provenance
    from roadtorch.runs.claim import claimed
    from roadtorch.settings import parse_assignments

    context.with_resource(claimed(out))
    settings = parse_assignments(assignments)
    evaluation = evaluate(
        opened(dataset, root, split, left_out),
        names,
        settings=settings,
        limit=limit,
        jobs=jobs,
        keep_in=out,
        watch=watched,
    )
    choices = [
        choose_threshold(evaluation, name, settings)
        for name, one in evaluation.detectors.items()
        if not one.is_baseline
    ]
    for choice in choices:
        path = out / f"{choice.detector.replace(':', '-')}.toml"
        lines = provenance(choice, evaluation, command_line(context))
        comment = "".join(f"# {line}\n" for line in lines)
        write_text(path, f"{comment}\n{as_toml(choice.detector, choice.settings)}\n")
    click.echo(choice_table(choices))
    tell_failures(evaluation)
    forget(out)
    context.exit(1 if evaluation.failures else 0)
