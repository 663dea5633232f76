"""roadtorch doctor: what is installed here, and whether it works."""

import json

import click


@click.command()
@click.option("--json", "machine_readable", is_flag=True, help="For programs.")
@click.pass_context
def doctor(context: click.Context, machine_readable: bool) -> None:
    """Check this installation and run it on a rendered street, in about five seconds.

    Versions, threads, picture and video formats, extras, the weights' hashes, and of the street:
    F, time and memory. Paste what it prints into a report. The exit code is 1 when something is
    broken; what is only missing comes with the line that installs it.
    """
    from roadtorch.doctor import as_document, as_text, examine, is_well

    report = examine()
    text = json.dumps(as_document(report), indent=2) if machine_readable else as_text(report)
    click.echo(text)
    context.exit(0 if is_well(report) else 1)
