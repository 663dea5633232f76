"""What the page gets as bytes: the picture, its thumbnail, its superpixels."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from roadtorch.annotate.machine import PictureView
from roadtorch.imaging.resize import WorkingSize, resized, working_size
from roadtorch.io.image import read_image, to_pixels

SHOWN = WorkingSize(pixels=1600 * 1200)
"""What is sent of a picture at most; strokes are in pixels of the whole one."""

THUMBNAIL = WorkingSize(pixels=112 * 84)


def picture_jpeg(path: Path, most: WorkingSize, quality: int) -> bytes:
    """A picture at a size of at most so many pixels as JPEG; InputError if it cannot be read."""
    image = read_image(path)
    small = resized(image, working_size(image.shape[-2], image.shape[-1], most)).clamp(0, 1)
    pixels = np.ascontiguousarray(to_pixels(small)[..., ::-1])
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


@lru_cache(maxsize=2000)
def thumbnail_jpeg(path: Path, changed: int) -> bytes:
    """A thumbnail; ``changed`` is the file's time, so that a new picture has a new one."""
    return picture_jpeg(path, THUMBNAIL, 80)


def superpixel_bytes(view: PictureView) -> bytes:
    """The superpixels of a view as uint16 (h,w), little endian, row by row."""
    return view.labels.numpy().astype("<u2").tobytes()
