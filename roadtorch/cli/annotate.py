"""roadtorch annotate: correct machine labels in a page; report, export and import corrections."""

from pathlib import Path

import click

from roadtorch.base.bounded import plural
from roadtorch.cli.options import PATH, DetectorOptions, SectionedCommand, detector_options

LABEL_FORMAT = click.Choice(("png", "coco"))


@click.command(cls=SectionedCommand)
@click.argument("folder", type=PATH)
@click.option("--out", type=PATH, help="Folder of the corrections. [FOLDER/corrections]")
@detector_options
@click.option("--report", "reports", is_flag=True, help="Print a report on corrections and exit.")
@click.option("--export", "exported", type=LABEL_FORMAT, help="Write the corrections to --to.")
@click.option("--to", type=PATH, help="Folder for --export.")
@click.option(
    "--import", "imported", type=LABEL_FORMAT, help="Read labels from --from as corrections."
)
@click.option("--from", "origin", type=PATH, help="Folder or COCO file for --import.")
@click.pass_context
def annotate_command(
    context: click.Context,
    folder: Path,
    out: Path | None,
    choice: DetectorOptions,
    reports: bool,
    exported: str | None,
    to: Path | None,
    imported: str | None,
    origin: Path | None,
) -> None:
    """Correct the machine labels of the images in FOLDER, in a page in your browser.

    The page is served to this computer only, to whoever has its address. Every stroke is saved
    at once; run the same command again to resume.
    """
    out = out or folder / "corrections"
    if reports:
        from roadtorch.annotate.report import corrections_report

        click.echo(corrections_report(out, folder))
    elif exported:
        from roadtorch.base.atomic import claim_results, relative_name, share_folder
        from roadtorch.data.correction_formats import CORRECTION_FORMATS
        from roadtorch.data.corrections import read_corrections

        if to is None:
            raise click.UsageError("Missing option '--to'")
        corrections = read_corrections(out, folder)
        context.with_resource(share_folder(to))
        labels = CORRECTION_FORMATS[exported]
        results = dict.fromkeys(labels.files(corrections), relative_name(out, to))
        context.with_resource(claim_results(to, results, hint="give another --to"))
        labels.write(corrections, to)
        click.echo(f"{plural(len(corrections), 'image')} written to {to}")
    elif imported:
        from roadtorch.annotate.session import import_labels
        from roadtorch.base.atomic import lock_folder

        if origin is None:
            raise click.UsageError("Missing option '--from'")
        context.with_resource(lock_folder(out))
        count = import_labels(imported, origin, folder, out)
        click.echo(f"{plural(count, 'image')} imported")
    else:
        from roadtorch.annotate.session import open_session
        from roadtorch.base.atomic import lock_folder
        from roadtorch.base.errors import ConfigError
        from roadtorch.inputs.images import find_images

        try:
            from roadtorch.annotate.server import make_page_server
        except ImportError:
            hint = "pip install 'roadtorch[annotate]'"
            raise ConfigError("annotate", "needs Starlette and uvicorn", hint) from None
        count = len(find_images([folder], out))
        detector, _ = choice.load()
        context.with_resource(lock_folder(out))
        server = make_page_server(open_session(folder, out, detector))
        click.echo(f"{count} images; corrections are saved in {out}")
        click.echo(f"Open {server.address.url}  (press Ctrl-C to stop)")
        server.run()
