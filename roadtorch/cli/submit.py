"""roadtorch submit: the files that the KITTI road benchmark's server wants."""

from pathlib import Path

import click

from roadtorch.cli.options import JOBS, OVERWRITE, PATH, QUIET, Choice, with_choice


@click.command()
@click.argument("root", metavar="ROOT", type=PATH)
@with_choice
@click.option("--out", type=PATH, required=True, help="Folder for the maps and the archive.")
@JOBS
@OVERWRITE
@QUIET
@click.pass_context
def submit(
    context: click.Context,
    root: Path,
    choice: Choice,
    out: Path,
    jobs: int,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Write a submission to the KITTI road benchmark.

    ROOT holds image_2 and calib, or testing/image_2 and testing/calib. The picture
    um_000012 gives um_road_000012.png, its likelihood in bird's-eye view (800 by 400, 8
    bits), and all of them submission.zip once every picture is done. index.csv lists the
    pictures. A second run goes on where the first one stopped.
    """
    from roadtorch.cli import config as configuration

    name, values = choice.named()

    from roadtorch.data.kitti import base_folder, calib_folder
    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.runs import batch, results, submission
    from roadtorch.runs.claim import claimed

    loaded = load_detector(name, **values)
    folder = base_folder(root, "testing")
    calib = calib_folder(folder)
    work = submission.Submission(loaded, calib)
    planned = submission.plan_maps(folder / "image_2", calib, out)
    effective = configuration.as_toml(loaded.name, loaded.settings)
    context.with_resource(claimed(out))
    results.keep_config(out, effective, overwrite)
    method = results.detector_method(loaded, effective, ["map"])
    failed = batch.run_jobs(planned, out, work, method, batch.Options(jobs, overwrite, quiet))
    archive = out / submission.ARCHIVE
    if failed:
        click.echo(f"roadtorch: {archive} not written, as maps are missing", err=True)
        context.exit(failed)
    submission.pack(planned, archive)
    if not quiet:
        click.echo(f"roadtorch: {len(planned)} maps in {archive}", err=True)
