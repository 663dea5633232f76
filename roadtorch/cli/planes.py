"""roadtorch planes: the colour planes and their combinations."""

import click

CIRCULAR = "; circular"


@click.command()
def planes() -> None:
    """List the colour planes with their ranges, and the representations made of them."""
    from roadtorch.cli.detectors import columns
    from roadtorch.imaging.color import PLANES, REPRESENTATIONS

    rows = [("plane", "low", "high", "meaning")]
    rows += [
        (name, f"{plane.low:g}", f"{plane.high:g}", plane.summary + CIRCULAR * plane.circular)
        for name, plane in PLANES.items()
    ]
    click.echo("\n".join(columns(rows)))
    click.echo()
    combined = [("representation", "planes")]
    combined += [(name, " ".join(parts)) for name, parts in REPRESENTATIONS.items()]
    click.echo("\n".join(columns(combined)))
