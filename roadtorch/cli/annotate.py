"""roadtorch annotate: correct machine labels in a page, report on it, bring labels in and out."""

from pathlib import Path

import click

from roadtorch.cli.options import PATH, DetectorOptions, Sectioned, with_detector

ORDERS = ("least-trust", "random")

FORMATS = ("png", "coco")


@click.command(cls=Sectioned)
@click.argument("folder", type=PATH)
@click.option("--out", type=PATH, help="Where corrections are kept. [FOLDER/corrections]")
@click.option("--port", type=click.IntRange(1, 65535), help="Port of the page. [a free one]")
@click.option(
    "--order",
    type=click.Choice(ORDERS),
    default=ORDERS[0],
    help="Which image comes next.",
)
@with_detector
@click.option("--report", "reports", is_flag=True, help="Say what was corrected, and stop.")
@click.option("--export", "exported", type=click.Choice(FORMATS), help="Write corrections to --to.")
@click.option("--to", type=PATH, help="Folder for --export.")
@click.option("--import", "imported", type=click.Choice(FORMATS), help="Read labels from --from.")
@click.option("--from", "origin", type=PATH, help="Folder of --import, or a COCO file.")
@click.pass_context
def annotate(
    context: click.Context,
    folder: Path,
    out: Path | None,
    port: int | None,
    order: str,
    choice: DetectorOptions,
    reports: bool,
    exported: str | None,
    to: Path | None,
    imported: str | None,
    origin: Path | None,
) -> None:
    """Correct the machine's labels of the images in FOLDER, in a page in your browser.

    The page is served to this computer alone, to whoever has its address. Every stroke is on disk
    at once; a second run resumes where the first one stopped.
    """
    out = out or folder / "corrections"
    if reports:
        from roadtorch.annotate.report import corrections_report

        click.echo(corrections_report(out, folder))
    elif exported:
        from roadtorch.base.atomic import shared
        from roadtorch.data.correction_formats import FORMATS as KNOWN
        from roadtorch.data.corrections import read_corrections

        if to is None:
            raise click.UsageError("Missing option '--to'")
        corrected = read_corrections(out, folder)
        context.with_resource(shared(to))
        KNOWN[exported].write(corrected, to)
        click.echo(f"{len(corrected)} images written to {to}")
    elif imported:
        from roadtorch.annotate.session import import_labels
        from roadtorch.run.folder import output_lock

        if origin is None:
            raise click.UsageError("Missing option '--from'")
        context.with_resource(output_lock(out))
        count = import_labels(imported, origin, folder, out)
        click.echo(f"{count} images brought in")
    else:
        from roadtorch.annotate.next_images import ImageOrder
        from roadtorch.annotate.session import opened_session
        from roadtorch.base.errors import ConfigError
        from roadtorch.inputs.images import find_images
        from roadtorch.run.folder import output_lock

        try:
            from roadtorch.annotate.server import page_server
        except ImportError:
            hint = "pip install 'roadtorch[annotate]'"
            raise ConfigError("annotate", "needs Starlette and uvicorn", hint) from None
        count = len(find_images([folder], out))
        detector, _ = choice.loaded()
        context.with_resource(output_lock(out))
        server = page_server(opened_session(folder, out, detector, order=ImageOrder(order)), port)
        click.echo(f"{count} images; corrections are kept in {out}")
        click.echo(f"Open {server.address.url}  (Ctrl-C ends it)")
        server.run()
