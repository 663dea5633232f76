"""Decoding of ROS image messages: sensor_msgs/Image and CompressedImage."""

from typing import Any

import cv2
import numpy as np
from torch import Tensor

from roadtorch.base.bounded import reason
from roadtorch.base.decoding import check_pixels
from roadtorch.base.errors import InputError
from roadtorch.base.image import decode_image, from_pixels, report_decoding_errors

RAW_IMAGE_TYPE = "sensor_msgs/msg/Image"
COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"

RGB_ORDER, BGR_ORDER = slice(0, 3), slice(2, None, -1)  # of three or four channels
PLAIN = {  # channels, bits, index of red, green and blue
    **{"mono8": (1, 8, 0), "8UC1": (1, 8, 0), "mono16": (1, 16, 0)},
    **{"rgb8": (3, 8, RGB_ORDER), "bgr8": (3, 8, BGR_ORDER), "8UC3": (3, 8, BGR_ORDER)},
    **{"rgba8": (4, 8, RGB_ORDER), "bgra8": (4, 8, BGR_ORDER), "8UC4": (4, 8, BGR_ORDER)},
    **{"rgb16": (3, 16, RGB_ORDER), "bgr16": (3, 16, BGR_ORDER)},
}
"""Encodings of sensor_msgs/image_encodings.hpp; the fourth channel is padding and is dropped."""

BAYER = {
    "bayer_rggb": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg": cv2.COLOR_BayerGRBG2RGB,
}
YUV = {
    **{"yuv422": cv2.COLOR_YUV2RGB_UYVY, "uyvy": cv2.COLOR_YUV2RGB_UYVY},
    **{"yuv422_yuy2": cv2.COLOR_YUV2RGB_YUYV, "yuyv": cv2.COLOR_YUV2RGB_YUYV},
}

READ_ENCODINGS = (*PLAIN, *(f"{name}{bits}" for name in BAYER for bits in (8, 16)), *YUV)


def decode_message(message: Any, origin: str) -> Tensor:
    """Decode a ROS image message to sRGB in [0, 1], shape (3, H, W); 16-bit 65535 becomes 1.

    message: a sensor_msgs/Image or CompressedImage of rosbags or rclpy.

    Raises:
        InputError: if the encoding is not supported, the message has too many pixels or too few
            bytes, or a compressed image cannot be decoded.
    """
    if not hasattr(message, "encoding"):
        return decode_image(message.data.tobytes(), origin)
    if message.encoding not in READ_ENCODINGS:
        problem = f"has the encoding {message.encoding!r}, which is not read"
        raise InputError(origin, problem, f"record one of {', '.join(READ_ENCODINGS)}")
    with report_decoding_errors(origin):
        check_pixels(message.width, message.height)
    encoding = message.encoding
    try:
        if encoding in PLAIN:
            channels, bits, order = PLAIN[encoding]
            return from_pixels(_read_rows(message, channels, bits)[..., order])
        if encoding in YUV:
            return from_pixels(cv2.cvtColor(_read_rows(message, 2, 8), YUV[encoding]))
        pattern = encoding.rstrip("0123456789")
        mosaic = _read_rows(message, 1, int(encoding.removeprefix(pattern)))
        return from_pixels(cv2.cvtColor(mosaic, BAYER[pattern]))
    except (ValueError, cv2.error) as error:
        raise InputError(origin, f"cannot be read: {reason(error)}", "record it again") from None


def _read_rows(message: Any, channels: int, bits: int) -> np.ndarray:
    """Return the samples (H, W, C) of a message in native byte order, a view of 8-bit ones."""
    row = message.width * channels * bits // 8
    step = message.step or row
    needed = step * (message.height - 1) + row  # the last row may lack its padding
    if step < row or not message.width or not message.height or len(message.data) < needed:
        size = f"{message.width} by {message.height} {message.encoding}, {message.step} a row"
        raise ValueError(f"it has {len(message.data)} bytes for {size}")
    data = np.frombuffer(message.data, np.uint8)
    if len(data) < step * message.height:
        data = np.pad(data, (0, step * message.height - len(data)))
    samples = data[: step * message.height].reshape(message.height, step)[:, :row]
    if bits == 16:
        samples = (
            np.ascontiguousarray(samples)
            .view(">u2" if message.is_bigendian else "<u2")
            .astype(np.uint16)
        )
    return samples.reshape(message.height, message.width, channels)
