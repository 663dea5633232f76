"""roadtorch export: write networks as files that run without Python."""

import shlex
from pathlib import Path

import click

from roadtorch.cli.options import (
    PATH,
    SETTING_OPTION,
    CheckedCommand,
    DetectorOptions,
    refuse_unused,
    suggest_detectors,
)


@click.command(cls=CheckedCommand)
@click.argument("name", shell_complete=suggest_detectors)
@click.option("--out", type=PATH, required=True, help="File NAME.onnx; for web, a folder.")
@click.option(
    "--format",
    "target",
    type=click.Choice(["onnx", "web"]),
    default="onnx",
    help="web: a page for browsers.",
)
@click.option("--mask", is_flag=True, help="The mask and its trust alone; a mask is uint8.")
@SETTING_OPTION
def export_command(
    name: str, out: Path, target: str, mask: bool, assignments: tuple[str, ...]
) -> None:
    """Export the part of a detector that runs without Python: fusion, layout:cnn-7.

    The model takes RGB images of any size, uint8 (N, height, width, 3), and returns maps of that
    size: pre- and postprocessing are included, except steps that need connected regions. The file
    is checked against Python before it is written.
    """
    from roadtorch.base.atomic import claim_results, lock_folder
    from roadtorch.export.export import export_detector
    from roadtorch.export.folders import WEB_FILES, export_page
    from roadtorch.layout.runtimes import MAX_DIFFERENCE

    refuse_unused(click.get_current_context(), onnx=target == "onnx")
    detector, _ = DetectorOptions(name, assignments).load()
    folder, files = (out, WEB_FILES) if target == "web" else (out.parent, (out.name,))
    with lock_folder(folder), claim_results(folder, dict.fromkeys(files, name)):
        exported = (
            export_page(detector, out)
            if target == "web"
            else export_detector(detector, out, "mask" if mask else "maps")
        )
    for file in exported.files:
        click.echo(f"{file}: {file.stat().st_size / 1e6:.2f} MB")
    click.echo(f"{name}: {exported.metadata['part']}")
    for key, text in exported.metadata.items():
        if key not in ("roadtorch", "detector", "part", "lacks"):
            click.echo(f"  {key:<18} {text}")
    parity = exported.parity
    click.echo(
        f"difference from Python on {parity.images} rendered images: "
        f"at most {parity.max_difference:.1e} ({parity.location}), "
        f"mean {parity.mean_difference:.1e}; allowed {MAX_DIFFERENCE:g}"
    )
    if target == "web":  # its page has the steps that the network's file lacks
        click.echo(f"try it: python -m http.server --directory {shlex.quote(str(out))}")
    else:
        click.echo(f"Not included: {exported.metadata['lacks']}. See docs/export.md for the cost.")
