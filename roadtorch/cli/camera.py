"""roadtorch camera: estimate ego car and horizon from the footage of one camera."""

from pathlib import Path

import click

from roadtorch.cli.options import FOOTAGE_ARGUMENT, PATH

MEAN_FRAMES = 12  # frames averaged in the check image


@click.command()
@FOOTAGE_ARGUMENT
@click.option("--out", type=PATH, default=Path("camera.toml"), help="File to write.")
@click.option(
    "--limit",
    type=click.IntRange(min=5),
    default=120,
    help="Sample at most this many frames, evenly spaced.",
)
@click.option("--camera-info", type=PATH, help="ROS camera_info as YAML, with distortion.")
def camera_command(
    footage: tuple[str, ...], out: Path, limit: int, camera_info: Path | None
) -> None:
    """Estimate ego car, horizon and seed row from the footage of one camera.

    FOOTAGE: images, folders, quoted globs or video files; at least 10 frames of different
    scenes. Writes --out for infer --camera, and an image to check it: the mean of the frames and
    one of them, with the ego car tinted, the horizon blue, the seed row orange. --camera-info
    adds the lens, of fewer than 5 frames the lens alone; if it has distortion, detectors see
    rectified views. What you add below [grid], such as height = 1.4, stays when the file is written
    again.
    """
    from roadtorch.base.atomic import claim_results, relative_name
    from roadtorch.base.errors import ConfigError
    from roadtorch.base.image import write_rgb
    from roadtorch.base.progress import Progress
    from roadtorch.camera.calibration import read_camera_info
    from roadtorch.camera.camera import Camera, draw_check_image
    from roadtorch.camera.footage import estimate_camera
    from roadtorch.inputs.find import locate_frames, read_frames
    from roadtorch.road.ego import has_ego_car, outline_rows

    if not out.name or out.is_dir():
        raise ConfigError(out, "is a folder", "give a file, such as camera.toml")
    check_file = out.with_suffix(".jpg")
    lens = None if camera_info is None else read_camera_info(camera_info)
    positions = locate_frames(footage, limit)
    inputs = {position.path.resolve() for position in positions}
    if check_file == out or {out.resolve(), check_file.resolve()} & inputs:
        raise ConfigError(out, "would replace footage or its own image", "name it camera.toml")
    origin = ", ".join(relative_name(path, out.parent) for path in footage)
    with claim_results(out.parent, {out.name: origin, check_file.name: origin}):
        earlier = Camera.read(out) if out.exists() else None
        frames = Progress(read_frames(positions), total=len(positions), unit="frame")
        camera = estimate_camera(frames, footage[0], lens)
        camera = camera.model_copy(update={"grid": earlier.grid}) if earlier else camera
        camera.write(out)
        sample = positions[:: max(1, len(positions) // MEAN_FRAMES)]
        write_rgb(check_file, draw_check_image(camera, list(read_frames(sample))))
    ego = "none found"
    if has_ego_car(camera.ego):
        rows = outline_rows(camera.ego.outline, camera.width)
        fraction, top = float((1 - rows).double().mean()), float(rows.min())
        ego = f"{fraction:.1%} of the image, from row {top:.2f} of the height"
    click.echo(f"ego car: {ego}")
    horizon = "unknown" if camera.horizon is None else f"row {camera.horizon:.2f}"
    click.echo(f"horizon: {horizon}; seed row: {camera.seed_row:.2f}")
    size = f"{camera.frames} frames of {camera.width}×{camera.height} pixels"
    click.echo(f"{size}; wrote {out}, and {check_file} to check it")
