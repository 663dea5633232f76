"""Rectified views of wide lenses: what they show, what comes back, and what a detector gains."""

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import read_image
from roadtorch.base.settings import build_settings
from roadtorch.camera.camera import Camera
from roadtorch.camera.footage import estimate_camera
from roadtorch.camera.ground import Lens, camera_pose, pinhole_lens, pixel_rays, project_rays
from roadtorch.camera.mounting import build_placement
from roadtorch.camera.views import (
    Rectification,
    View,
    merge_views,
    rectified_views,
    sample_view,
    view_itself,
)
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from tests.streets import drive, scene

WIDTH, HEIGHT = 192, 144


def make_lens(focal: float, *coefficients: float, model: str = "equidistant", **more: Any) -> Lens:
    """Return a lens whose axis meets the centre of images of 192×144 pixels."""
    values = {"focal_x": focal, "focal_y": focal, "model": model, "coefficients": coefficients}
    return build_settings(Lens, pinhole_lens(WIDTH, HEIGHT, 60).model_dump() | values | more)


LENSES = {
    "equidistant": make_lens(64, 0, 0, 0, 0),
    "circle inside": make_lens(45, 0, 0, 0, 0, field_of_view=170.0),
    "Kannala-Brandt": make_lens(70, -0.05, 0.002, 0, 0, field_of_view=180.0),
    "squeezed": make_lens(64, 0.01, 0, 0, 0, focal_x=50.0),
    "one view": make_lens(100, 0, 0, 0, 0),
    "plumb_bob": make_lens(90, -0.2, 0.03, 0.001, 0, model="plumb_bob"),
}


def ground_texture(rays: np.ndarray, pitch: float) -> np.ndarray:
    """Return values (n,) in [0, 1] of rays (n, 3) of a camera one metre above a road with lines.

    The road is 6 m wide and fades towards its sides, its lines are 2 m apart; the sky is 0.
    """
    ahead, aside, up = (rays @ np.array(camera_pose(1, pitch).axes)).T
    depth = np.maximum(-up / np.linalg.norm(rays, axis=1), 1e-3)
    x, y = np.stack([ahead, aside]) / np.linalg.norm(rays, axis=1) / depth
    road = np.exp(-((y / 6) ** 2)) * (0.75 + 0.25 * np.cos(x) * np.cos(math.pi * y / 2))
    return road * np.clip((depth - 0.1) * 4, 0, 1)


def view_rays(lens: Lens, axes: Any = None) -> np.ndarray:
    """Return the rays (H · W, 3) of a lens's pixels; axes: of a view in the camera's frame."""
    rows, columns = np.mgrid[: lens.height, : lens.width]
    rays = pixel_rays(lens, np.stack([columns.ravel(), rows.ravel()], 1).astype(float))
    return rays if axes is None else rays @ np.array(axes)


def texture_image(lens: Lens, pitch: float, axes: Any = None) -> Tensor:
    """Render the texture as a lens sees it, (H, W)."""
    values = ground_texture(view_rays(lens, axes), pitch)
    return torch.from_numpy(values).reshape(lens.height, lens.width).float()


def coverage(lens: Lens, views: tuple[View, ...]) -> Tensor:
    """Return the pixels, bool (H, W), that a view shows."""
    return merge_views(
        [torch.ones(view.lens.height, view.lens.width) for view in views],
        lens,
        views,
        (HEIGHT, WIDTH),
        [1.0] * len(views),
    ).bool()


@pytest.mark.parametrize("pitch", [0.0, 25.0, 55.0])
@pytest.mark.parametrize("name", LENSES)
def test_a_view_is_the_ground_in_closed_form_and_its_likelihood_comes_back(
    name: str, pitch: float
) -> None:
    lens = LENSES[name]
    views = rectified_views(lens, pitch)
    image = texture_image(lens, pitch)

    sampled = [sample_view(image.expand(3, -1, -1), lens, view)[0] for view in views]
    exact = [texture_image(view.lens, pitch, view.axes) for view in views]

    for values, expected, view in zip(sampled, exact, views, strict=True):
        seen = torch.from_numpy(project_rays(lens, view_rays(view.lens, view.axes))[1])
        assert (values - expected).flatten()[seen].abs().mean() < 0.02
    covered = coverage(lens, views)
    back = merge_views(exact, lens, views, (HEIGHT, WIDTH), [1.0] * len(views))
    assert (back - image)[covered].abs().mean() < 0.01
    assert (back - image)[covered].abs().quantile(0.99) < 0.1
    assert not back[~covered].any()
    rays, positions = view_rays(lens), np.mgrid[:HEIGHT, :WIDTH][::-1].reshape(2, -1).T
    below = -(rays @ np.array(camera_pose(1, pitch).axes))[:, 2] / np.linalg.norm(rays, axis=1)
    in_circle = np.abs(project_rays(lens, rays)[0] - positions).max(1) < 0.5
    is_ground = in_circle & (below > 0) & (below < math.sin(math.radians(60)))
    assert covered.flatten()[torch.from_numpy(is_ground)].float().mean() > 0.94


@pytest.mark.parametrize(("degrees", "count"), [(60, 1), (105, 1), (115, 3), (150, 3), (185, 3)])
def test_wider_lenses_get_three_upright_views(degrees: float, count: int) -> None:
    lens = make_lens(WIDTH / math.radians(degrees), 0, 0, 0, 0)

    views = rectified_views(lens, 30.0)

    assert len(views) == count
    if count == 3:
        up = np.array(camera_pose(1, 30).axes)[:, 2]  # in the frame of the camera
        for view in views:
            right, down, ahead = np.array(view.axes) @ up
            assert right == pytest.approx(0, abs=1e-9)
            assert down < 0
            assert ahead < 0  # all look down a little
            assert view.lens.width * view.lens.height == pytest.approx(WIDTH * HEIGHT, rel=0.02)
        sides = [np.array(view.axes)[2, 0] for view in views]
        assert sides[0] == pytest.approx(0, abs=1e-9)
        assert sides[1] < -0.1 < 0.1 < sides[2]


def test_masks_are_united_labels_those_of_the_heaviest_view_and_outside_is_nothing() -> None:
    lens, size = LENSES["circle inside"], (HEIGHT, WIDTH)
    views = rectified_views(lens, 0.0)
    shapes = [(view.lens.height, view.lens.width) for view in views]
    covered = coverage(lens, views)

    marks = [torch.full(shape, number == 2) for number, shape in enumerate(shapes)]
    numbers = [torch.full(shape, number + 7) for number, shape in enumerate(shapes)]
    mask = merge_views(marks, lens, views, size, [1.0, 1.0, 1.0])
    labels = merge_views(numbers, lens, views, size, [1.0, 0.5, 0.25])

    third = coverage(lens, views[2:])
    assert mask.dtype == torch.bool
    assert mask.equal(third)
    assert labels.dtype == torch.int64
    assert labels[coverage(lens, views[:1])].unique().tolist() == [7]
    assert labels.unique().tolist() == [0, 7, 8, 9]
    assert (labels > 0).equal(covered)
    values = [map.to(torch.float32) for map in numbers]
    overlap = coverage(lens, views[:1]) & coverage(lens, views[1:2]) & ~third
    mean = merge_views(values, lens, views, size, [1.0, 0.5, 0.5])
    torch.testing.assert_close(mean[overlap], torch.tensor(22 / 3).expand(int(overlap.sum())))
    circle = (torch.arange(WIDTH) - (WIDTH - 1) / 2).square() < (45 * math.radians(85)) ** 2
    assert not covered[HEIGHT // 2, ~circle].any()
    assert covered[HEIGHT // 2, circle].float().mean() > 0.93


def test_a_lens_that_sees_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match="lens: sees nothing"):
        rectified_views(make_lens(64, 0, 0, 0, 0, centre_x=5000.0), 0.0)


# --- the camera's file ------------------------------------------------------------------


def warp(image: Tensor, degrees: float) -> tuple[Lens, Tensor]:
    """Return an equidistant lens of an image's size, and the image (C, H, W) as it sees it.

    degrees: horizontal field of view of the image, and of the lens. Black beyond the image.
    """
    height, width = image.shape[-2:]
    focal = width / math.radians(degrees)
    pinhole = pinhole_lens(width, height, degrees)
    fisheye = {"model": "equidistant", "coefficients": (0,) * 4, "focal_x": focal, "focal_y": focal}
    lens = build_settings(Lens, pinhole.model_dump() | fisheye)
    return lens, merge_views([image], lens, [view_itself(pinhole)], (height, width), [1.0])


def test_the_horizon_is_estimated_without_distortion_and_all_comes_back(tmp_path: Path) -> None:
    frames = [warp(frame, 140)[1] for frame in drive(rise=0)]
    lens = warp(frames[0], 140)[0]

    camera = estimate_camera(frames, lens=lens)
    camera.write(tmp_path / "camera.toml")

    row = project_rays(lens, np.array([[0, (0.42 - 0.5) * 120 / warp_focal(140), 1.0]]))[0][0, 1]
    assert camera.horizon is not None
    assert camera.horizon * 120 - 0.5 == pytest.approx(row, abs=5)
    assert Camera.read(tmp_path / "camera.toml") == camera


def warp_focal(degrees: float) -> float:
    """Return the focal length in pixels of the pinhole lens of images 160 pixels wide."""
    return 80 / math.tan(math.radians(degrees) / 2)


def test_detectors_and_the_grid_take_the_lens_of_a_camera(tmp_path: Path) -> None:
    values = {"width": WIDTH, "height": HEIGHT, "frames": 9, "horizon": 0.3, "seed_row": 1.0}
    lens = LENSES["Kannala-Brandt"]
    camera = Camera(**values, lens=lens)
    camera.write(tmp_path / "camera.toml")

    rectification = load_detector("prior:rows", camera=camera).settings.rectification
    read = Camera.read(tmp_path / "camera.toml")
    placement = build_placement(read, {"height": 1.0}, of_bags=False)
    straight = Camera(**values, lens=pinhole_lens(WIDTH, HEIGHT, 60))

    assert rectification is not None
    assert rectification.lens == lens
    above = project_rays(lens, np.array([[0, -math.tan(math.radians(rectification.pitch)), 1.0]]))
    assert above[0][0, 1] == pytest.approx(0.3 * HEIGHT - 0.5, abs=1e-3)
    assert placement.lens == lens
    assert not placement.needs_lens
    assert load_detector("prior:rows", camera=straight).settings.rectification is None


# --- detectors --------------------------------------------------------------------------


def detect(name: str, image: Tensor, lens: Lens | None, pitch: float = 0.0) -> Detection:
    """Detect the road, in rectified views if there is a lens."""
    if lens is None:
        return load_detector(name)(image)
    values = {"lens": lens.model_dump(exclude_defaults=True), "pitch": pitch}
    return load_detector(name, rectification=values)(image)


@pytest.mark.parametrize("name", ["fusion", "cpf", "ufl", "prior:triangle", "layout:cnn-7"])
def test_the_maps_of_a_fisheye_have_its_shape_and_end_at_its_circle(name: str) -> None:
    lens = LENSES["circle inside"]
    image = scene(0, HEIGHT, WIDTH, dusk=0.0).image

    detection = detect(name, image, lens)

    covered = coverage(lens, (view_itself(lens),))
    assert not detection.likelihood[~covered].any()
    assert detection.mask.any()
    plain = detect(name, image, None)
    assert detection.cues.keys() == plain.cues.keys()
    for cue, values in detection.cues.items():
        assert (values.shape, values.dtype) == (plain.cues[cue].shape, plain.cues[cue].dtype)
    wrapped = copy.deepcopy(load_detector(name, rectification=Rectification(lens=lens)))
    assert wrapped(image).likelihood.equal(detection.likelihood)
    with pytest.raises(InputError, match="the calibration 192×144"):
        detect(name, image[:, :72], lens)


def f_score(mask: Tensor, road: Tensor, valid: Tensor) -> float:
    mask, road = mask & valid, road & valid
    return 2 * int((mask & road).sum()) / int(mask.sum() + road.sum())


@pytest.mark.data
@pytest.mark.parametrize("every", [2, pytest.param(1, marks=pytest.mark.slow)])
def test_a_known_lens_gains_on_images_warped_by_it_and_loses_no_trail(
    every: int, data_root: Path
) -> None:
    scores, detector = [], load_detector("fusion")
    for folder in sorted((data_root / "many").glob("*/images"))[::every]:
        files = sorted(folder.iterdir())
        image = read_image(files[len(files) // 2])
        maps = torch.cat([image, torch.ones_like(image[:1]), detector(image).mask[None].float()])
        lens, (*planes, valid, road) = warp(maps, 140)
        warped = torch.stack(planes).clamp(0, 1)
        masks = [detect("fusion", warped, known).mask for known in (None, lens)]
        scores.append([f_score(mask, road > 0.5, valid > 0.5) for mask in masks])

    without, known = np.transpose(scores)
    assert len(scores) >= 14 / every
    assert known.mean() > without.mean() + 0.01
    assert (known - without).min() > -0.1  # where views show bare ground without a horizon
