"""roadtorch camera: what one camera's footage tells about it."""

from pathlib import Path

import click

from roadtorch.cli.options import FOOTAGE, PATH

SHOWN = 12  # frames that the mean in the image is made of


@click.command()
@FOOTAGE
@click.option("--out", type=PATH, default=Path("camera.toml"), help="File to write.")
@click.option(
    "--frames",
    "most",
    type=click.IntRange(min=5),
    default=120,
    help="Frames to look at, evenly chosen.",
)
def camera(footage: tuple[str, ...], out: Path, most: int) -> None:
    """Find what stays the same in the footage of one camera: ego car, horizon, seed row.

    FOOTAGE: images, folders, quoted globs, video files; 10 frames or more of different
    places. Writes --out for infer --camera, and beside it an image to check: the mean of
    the frames and one of them, with the ego car tinted, the horizon blue, the seed row orange.
    """
    from roadtorch.base.image import write_jpeg
    from roadtorch.base.progress import Progress
    from roadtorch.camera.camera import check_image
    from roadtorch.camera.footage import camera_of
    from roadtorch.inputs.find import frame_places, read_frames
    from roadtorch.road.ego import is_given, outline_rows

    image = out.with_suffix(".jpg")
    places = frame_places(footage, most)
    _refuse_replacing(out, image, {place.path.resolve() for place in places})
    frames = Progress(read_frames(places), total=len(places), unit="frame")
    camera = camera_of(frames, footage[0])
    camera.write(out)
    shown = places[:: max(1, len(places) // SHOWN)]
    write_jpeg(image, check_image(camera, list(read_frames(shown))))
    ego = "none seen"
    if is_given(camera.ego):
        rows = outline_rows(camera.ego.outline, camera.width)
        share, top = float((1 - rows).double().mean()), float(rows.min())
        ego = f"{share:.1%} of the image, from row {top:.2f} of the height"
    click.echo(f"ego car: {ego}")
    click.echo(f"horizon: row {camera.horizon:.2f}; seed row: {camera.seed_row:.2f}")
    size = f"{camera.frames} frames of {camera.width}×{camera.height} pixels"
    click.echo(f"{size}; written: {out}, and {image} to check")


def _refuse_replacing(out: Path, image: Path, inputs: set[Path]) -> None:
    """Refuse to write over what is not ours: ConfigError."""
    from roadtorch.base.errors import ConfigError, RoadtorchError
    from roadtorch.camera.camera import Camera

    if image == out or {out.resolve(), image.resolve()} & inputs:
        raise ConfigError(out, "would replace footage, or its own image", "name it camera.toml")
    if out.exists():
        try:
            Camera.read(out)
        except RoadtorchError:
            problem = "is there and no file of a camera"
            raise ConfigError(out, problem, "give another --out") from None
    elif image.exists():
        raise ConfigError(image, "is there and not ours", "give another --out")
