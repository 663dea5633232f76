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
    limit: int | None,
    jobs: int,
) -> None:
    """Choose thresholds on the labelled pictures of DATASET at ROOT.

    The threshold with the highest F, averaged over the drives, goes into OUT/NAME.toml
    together with the detector's settings and this command; use it with infer --config.
    What such a choice is worth is shown beside it: F and IoU of each drive at the
    threshold that the other drives choose.
    """
    from roadtorch.cli.batch import make_writable
    from roadtorch.cli.config import as_toml
    from roadtorch.cli.evaluate import command_line, run_pass
    from roadtorch.data.catalogue import open_dataset
    from roadtorch.evaluation import tuning
    from roadtorch.evaluation.plan import described, make_plan
    from roadtorch.evaluation.progress import Progress, fingerprint
    from roadtorch.files import write_text

    make_writable(out)
    opened = open_dataset(dataset, root, split)
    plan = make_plan(opened, names, assignments, limit=limit)
    progress = Progress(out, fingerprint(plan.dataset, described(plan)))
    failures = run_pass(plan, jobs, progress)
    choices = [
        tuning.choose(name, plan, progress.tallies[name])
        for name in plan.detectors
        if not name.startswith("prior:")
    ]
    command = command_line(context)
    for choice in choices:
        path = out / f"{choice.detector.replace(':', '-')}.toml"
        comment = "".join(f"# {line}\n" for line in tuning.provenance(choice, opened, command))
        write_text(path, f"{comment}\n{as_toml(choice.detector, choice.settings)}\n")
    click.echo(tuning.table(choices))
    for failure in failures:
        click.echo(f"failed: {failure.item.name}: {failure.failure}", err=True)
    progress.finish()
    context.exit(1 if failures else 0)
