"""roadtorch submit: the files that the KITTI road benchmark's server wants."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import (
    PATH,
    DetectorOptions,
    as_toml,
    with_detector,
    with_run,
)

if TYPE_CHECKING:
    from roadtorch.run.run import RunOptions


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
    run: "RunOptions",
) -> None:
    """Write a submission to the KITTI road benchmark.

    ROOT holds image_2 and calib, or testing/image_2 and testing/calib. The picture
    um_000012 gives um_road_000012.png, its likelihood in bird's-eye view (800 by 400, 8
    bits), and all of them submission.zip once every picture is done. index.csv lists the
    pictures. A second run resumes where the first one stopped.
    """
    from roadtorch.data.kitti import base_folder, calib_folder
    from roadtorch.inputs.find import Inputs
    from roadtorch.run.ledger import Method
    from roadtorch.run.loop import Inference, Task
    from roadtorch.run.memo import key_of
    from roadtorch.run.plan import plan
    from roadtorch.run.run import open_run
    from roadtorch.run.workers import settle
    from roadtorch.run.writers.kitti import ARCHIVE, BirdsEyeMaps, pack, pictures_to_submit

    settle(threads=1)
    detector, _ = choice.loaded()
    base = base_folder(root, "testing")
    maps = BirdsEyeMaps(out, calib_folder(base))
    pictures = pictures_to_submit(base / "image_2", maps.calib, out)
    todo = plan(Inputs(pictures, []), out, maps.suffixes)
    effective = as_toml(detector.name, detector.settings)
    own = context.with_resource(open_run(out, effective, todo.count, run))
    method = Method(key_of(detector), ("map",))
    if failed := own.pictures(pictures, Task(Inference(detector), maps, method)):
        click.echo(f"roadtorch: {out / ARCHIVE} not written, as maps are missing", err=True)
        context.exit(failed)
    archive = pack(pictures, out)
    if not run.quiet:
        click.echo(f"roadtorch: {len(pictures)} maps in {archive}", err=True)
