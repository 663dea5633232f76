"""Bird's-eye view one point at a time, through every coordinate frame."""

import math
from collections.abc import Mapping

import numpy as np

from roadtorch.camera.calibration import Calibration

FOCAL = 130.0
CAMERA_HEIGHT = 1.6  # metres


def turn(pitch: float, yaw: float, roll: float) -> np.ndarray:
    """Return the rotation (3, 3) about x by pitch, y by yaw and z by roll, in radians."""
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(a), math.cos(a)) for a in (pitch, yaw, roll))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def made_up_rows(
    pitch: float = 0.02, yaw: float = -0.01, roll: float = 0.005, shift: float = 0.06
) -> dict[str, np.ndarray]:
    """Return the matrices of a made-up camera, for images of 160 by 120 pixels.

    It is 1.6 m above the road; with no angles and no shift it is a plain pinhole.
    """
    projection = np.array(
        [[FOCAL, 0, 80.5, FOCAL * shift], [0, FOCAL, 50.5, shift], [0, 0, 1, shift / 20]]
    )
    below = np.array([shift / 5, -CAMERA_HEIGHT, shift])
    camera_to_road = np.column_stack([turn(pitch, yaw, roll), below])
    rectification = turn(pitch / 3, -yaw / 2, roll)
    return {"P2": projection, "R0_rect": rectification, "Tr_cam_to_road": camera_to_road}


def calibration(rows: Mapping[str, object]) -> Calibration:
    """Return the calibration as it is read."""
    values = (np.array(rows[name]).ravel().tolist() for name in ("P2", "R0_rect", "Tr_cam_to_road"))
    return Calibration(*map(tuple, values))


def calibration_text(rows: dict[str, np.ndarray]) -> str:
    """Return a calibration file with these rows, between others that are ignored."""
    lines = [f"{name}: {' '.join(f'{x:.12e}' for x in row.ravel())}" for name, row in rows.items()]
    return "\n".join(["P0: 1 2 3", *lines, "Tr_imu_to_velo: none", ""])


def see(rows: dict[str, np.ndarray], x: float, z: float) -> tuple[float, float]:
    """Return the image point of the road's point (x, 0, z): road, camera, rectified, image."""
    rotation, offset = rows["Tr_cam_to_road"][:, :3], rows["Tr_cam_to_road"][:, 3]
    camera = np.linalg.solve(rotation, np.array([x, 0.0, z]) - offset)
    rectified = rows["R0_rect"] @ camera
    across, down, depth = rows["P2"] @ np.append(rectified, 1.0)
    return across / depth, down / depth


def cell_value(image: np.ndarray, rows: dict[str, np.ndarray], row: int, column: int):
    """Return the value of one cell in the bird's-eye map of an image (H, W)."""
    x = float(np.float32(-10 + (column + 0.5) * 0.05))
    z = float(np.float32(46 - (row + 0.5) * 0.05))
    u, v = see(rows, x, z)
    height, width = image.shape
    if 1 <= u <= width and 1 <= v <= height:
        return image[math.floor(v) - 1, math.floor(u) - 1]
    return image.dtype.type(0)
