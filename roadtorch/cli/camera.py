"""roadtorch camera: what one camera's footage tells about it."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import FOOTAGE, PATH

if TYPE_CHECKING:
    from roadtorch.camera.camera import Camera

SHOWN = 12  # frames that the mean in the picture is made of


@click.command()
@FOOTAGE
@click.option(
    "--out", type=PATH, default=Path("camera.toml"), show_default=True, help="File to write."
)
@click.option(
    "--frames",
    "most",
    type=click.IntRange(min=5),
    default=120,
    show_default=True,
    help="Frames to look at, evenly chosen.",
)
def camera(footage: tuple[str, ...], out: Path, most: int) -> None:
    """Find what stays the same in the footage of one camera: ego car, horizon, seed row.

    FOOTAGE: pictures, folders, quoted globs, video files; 10 frames or more of different
    places. Writes --out for infer --camera, and beside it a picture to check: the mean of
    the frames and one of them, with the ego car tinted, the horizon blue, the seed row orange.
    """
    from roadtorch.camera.camera import check_picture
    from roadtorch.camera.footage import camera_of
    from roadtorch.io.image import write_jpeg
    from roadtorch.runtime.progress import Progress
    from roadtorch.sources.open import frame_places, read_frames

    picture = out.with_suffix(".jpg")
    places = frame_places(footage, most)
    _refuse_replacing(out, picture, {place.path.resolve() for place in places})
    seen = Progress(read_frames(places), total=len(places), unit="frame")
    found = camera_of(seen, footage[0])
    shown = places[:: max(1, len(places) // SHOWN)]
    found.write(out)
    write_jpeg(picture, check_picture(found, list(read_frames(shown))))
    click.echo("\n".join(told(found, out, picture)))


def told(camera: "Camera", out: Path, picture: Path) -> list[str]:
    """What was found, in three lines."""
    from roadtorch.road.ego import is_given, outline_rows

    ego = "ego car: none seen"
    if is_given(camera.ego):
        rows = outline_rows(camera.ego.outline, camera.width)
        share = float((1 - rows).double().mean())
        ego = f"ego car: {share:.1%} of the picture, from row {float(rows.min()):.2f} of the height"
    size = f"{camera.frames} frames of {camera.width}×{camera.height} pixels"
    return [
        ego,
        f"horizon: row {camera.horizon:.2f}; seed row: {camera.seed_row:.2f}",
        f"{size}; written: {out}, and {picture} to check",
    ]


def _refuse_replacing(out: Path, picture: Path, inputs: set[Path]) -> None:
    """Refuse to write over what is not ours: ConfigError."""
    from roadtorch.camera.camera import Camera
    from roadtorch.errors import ConfigError, RoadtorchError

    if picture == out or {out.resolve(), picture.resolve()} & inputs:
        raise ConfigError(out, "would replace footage, or its own picture", "name it camera.toml")
    if out.exists():
        try:
            Camera.read(out)
        except RoadtorchError:
            what = "is there and no file of a camera"
            raise ConfigError(out, what, "give another --out") from None
    elif picture.exists():
        raise ConfigError(picture, "is there and not ours", "give another --out")
