"""roadtorch export: networks as files that run without Python."""

from pathlib import Path

import click

from roadtorch.cli.options import PATH, SETTING, suggest_detectors


@click.command()
@click.argument("name", shell_complete=suggest_detectors)
@click.option(
    "--out",
    type=PATH,
    required=True,
    help="File: NAME.onnx; for web and hub, a folder.",
)
@click.option(
    "--format",
    "kind",
    type=click.Choice(["onnx", "web", "hub"]),
    default="onnx",
    help="web is a page for browsers; hub a folder for model hubs, which load_detector reads.",
)
@SETTING
def export(name: str, out: Path, kind: str, assignments: tuple[str, ...]) -> None:
    """Write the part of a detector that runs without Python: fusion, layout:cnn-7.

    The file takes images as bytes (N, height, width, 3) in RGB, of any size, and gives maps of
    that size: all that happens before and behind the network is inside, but what needs connected
    regions. What it says is compared with Python before it is written.
    """
    from roadtorch.base.settings import parse_assignments
    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.export.export import BOUND, export_detector
    from roadtorch.export.folders import export_folder, export_page
    from roadtorch.run.folder import output_lock

    detector = load_detector(name, **parse_assignments(assignments))
    with output_lock(out if kind in ("web", "hub") else out.parent):
        if kind == "hub":
            for file in export_folder(detector, out):
                click.echo(f"{file}: {file.stat().st_size / 1e6:.2f} MB")
            click.echo(f"load it: load_detector({str(out)!r})")
            return
        exported = export_page(detector, out) if kind == "web" else export_detector(detector, out)
    for file in exported.files:
        click.echo(f"{file}: {file.stat().st_size / 1e6:.2f} MB")
    click.echo(f"{name}: {exported.notes['part']}")
    for key, text in exported.notes.items():
        if key not in ("roadtorch", "detector", "part", "lacks"):
            click.echo(f"  {key:<18} {text}")
    parity = exported.parity
    click.echo(
        f"parity with Python on {parity.images} rendered images: at most {parity.most:.1e} off "
        f"({parity.where}), {parity.mean:.1e} in the mean; allowed {BOUND:g}"
    )
    lacks = exported.notes["lacks"]
    click.echo(f"It lacks: {lacks}. What that costs: docs/export.md")
    if kind == "web":
        click.echo(f"try it: python -m http.server --directory {out}")
