"""roadtorch submit: the files that the KITTI road benchmark's server wants."""

from pathlib import Path

import click

from roadtorch.cli.options import PATH, with_detector, with_run
from roadtorch.runs.options import DetectorOptions, RunOptions, as_toml


@click.command()
@click.argument("root", metavar="ROOT", type=PATH)
@with_detector
@click.option("--out", type=PATH, required=True, help="Folder for the maps and the archive.")
@with_run
@click.pass_context
def submit(
    context: click.Context,
    root: Path,
    choice: DetectorOptions,
    out: Path,
    options: RunOptions,
) -> None:
    """Write a submission to the KITTI road benchmark.

    ROOT holds image_2 and calib, or testing/image_2 and testing/calib. The picture
    um_000012 gives um_road_000012.png, its likelihood in bird's-eye view (800 by 400, 8
    bits), and all of them submission.zip once every picture is done. index.csv lists the
    pictures. A second run goes on where the first one stopped.
    """
    from roadtorch.data.kitti import base_folder, calib_folder
    from roadtorch.runs import pictures, results
    from roadtorch.runs.folder import result_folder

    loaded, _ = choice.loaded()
    base = base_folder(root, "testing")
    planned = results.plan_maps(base / "image_2", calib_folder(base), out)
    effective = as_toml(loaded.name, loaded.settings)
    folder = context.with_resource(result_folder(out, effective, options.overwrite))
    method = results.detector_method(loaded, effective, ["map"])
    failed = pictures.run_pictures(planned, results.Submission(loaded), method, folder, options)
    archive = out / results.ARCHIVE
    if failed:
        click.echo(f"roadtorch: {archive} not written, as maps are missing", err=True)
        context.exit(failed)
    results.pack(planned, archive)
    if not options.quiet:
        click.echo(f"roadtorch: {len(planned)} maps in {archive}", err=True)
