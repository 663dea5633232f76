"""A ROS 2 talker: publishes images of every encoding and prints the node's answers as JSON.

    python talker.py SECONDS [--rate HZ] [--size WIDTHxHEIGHT] [--encodings rgb8,mono8]
        [--image FILE] [--save FILE.npz] [--ros-args -r __ns:=/front]

One line of JSON: by encoding the stamps and frames that came back, the shapes of masks and
confidences, and the ages of the answers in milliseconds; labels, grids and diagnostics. FILE.npz
gets mask, confidence, points, grid and labels of one stamp, as Nav2's layer matches them.
"""

import argparse
import json
import time
from collections import defaultdict
from functools import partial
from typing import Any

import cv2
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

try:
    from vision_msgs.msg import LabelInfo
except ImportError:  # the node publishes no labels then
    LabelInfo = None

CHANNELS = {
    **dict.fromkeys(("mono8", "mono16", "bayer_rggb8"), 1),
    **dict.fromkeys(("yuv422", "yuv422_yuy2"), 2),
    **dict.fromkeys(("rgb8", "bgr8", "rgb16"), 3),
    **dict.fromkeys(("rgba8", "bgra8"), 4),
}
SETTLING = 1.2  # seconds for discovery before the first image, for answers after the last
ENCODINGS = (*CHANNELS, "compressed")
MATCHED = {"mask": Image, "confidence": Image, "points": PointCloud2, "grid": OccupancyGrid}


def message_of(encoding, pixels, number):
    """Return a message of an encoding; its time stamp is its number."""
    if encoding == "compressed":
        message = CompressedImage(format="jpeg")
        message.data.frombytes(cv2.imencode(".jpg", pixels)[1].tobytes())
    else:
        height, width = pixels.shape[:2]
        message = Image(height=height, width=width, encoding=encoding)
        count = CHANNELS.get(encoding, 3)
        samples = np.concatenate([pixels] * 2, 2)[..., :count].astype(np.uint8)
        if encoding.endswith("16"):
            samples = samples.astype(np.uint16) * 257
        message.step = samples[0].nbytes
        message.data.frombytes(np.ascontiguousarray(samples).tobytes())
    message.header.stamp.sec, message.header.frame_id = number, "camera_optical"
    return message


def values_of(message):
    """Return the values in a message's data, from a sample: slow callbacks delay the next one."""
    return {*np.unique(np.asarray(message.data)[::7]).tolist()}


def save_topics(path, messages):
    """Save the values of messages of one stamp, and the frame of the points."""
    cloud, arrays = messages.pop("points"), {}
    rows = np.frombuffer(cloud.data, np.uint8).reshape(cloud.height, cloud.width, cloud.point_step)
    starts = {field.name: field.offset for field in cloud.fields}
    values = [np.ascontiguousarray(rows[..., starts[n] : starts[n] + 4]) for n in "xyz"]
    for name, message in messages.items():
        arrays[name] = np.array(message.data).reshape(getattr(message, "info", message).height, -1)
    points = np.concatenate([value.view(np.float32) for value in values], -1)
    np.savez(path, frame=cloud.header.frame_id, points=points, **arrays)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("seconds", type=float)
    parser.add_argument("--rate", type=float, default=10)
    parser.add_argument("--size", default="160x120")
    parser.add_argument("--encodings", default=",".join(ENCODINGS))
    parser.add_argument("--image", help="instead of noise")
    parser.add_argument("--save", help="file for the topics of one stamp")
    options, ros_args = parser.parse_known_args()
    width, height = map(int, options.size.split("x"))
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    if options.image:
        pixels = np.asarray(cv2.imread(options.image))[..., ::-1]
        pixels = cv2.resize(np.ascontiguousarray(pixels), (width, height))
    rclpy.init(args=ros_args)
    node, sent, results = rclpy.create_node("talker"), {}, defaultdict[str, Any](list)
    matched = defaultdict[int, dict[str, Any]](dict)
    late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

    def mask(message):
        number = message.header.stamp.sec
        encoding, start = sent.get(number, ("", 0))
        results[encoding].append(1000 * (time.monotonic() - start))
        results["mask"] = [message.header.frame_id, message.height, message.width, message.encoding]
        results["values"] = sorted({*results["values"], *values_of(message)})

    def confidence(message):
        results["confidence"] = [message.header.frame_id, message.height, message.width]

    def grid(message):
        results["grid"] = [message.header.frame_id, message.info.height, message.info.width]
        results["cells"] = sorted(values_of(message))

    def match(name, message):
        matched[message.header.stamp.sec][name] = message

    def labels(message):
        results["labels"] = [[kind.class_id, kind.class_name] for kind in message.class_map]

    def diagnostics(message):
        name = node.get_namespace().strip("/") or "road"
        status = next(status for status in message.status if status.name.endswith(name))
        results["diagnostics"] = {pair.key: pair.value for pair in status.values}
        results["words"] = [*dict.fromkeys([*results["words"], status.message])]

    node.create_subscription(Image, "segmentation/mask", mask, qos_profile_sensor_data)
    node.create_subscription(Image, "segmentation/confidence", confidence, qos_profile_sensor_data)
    node.create_subscription(OccupancyGrid, "segmentation/grid", grid, late)
    if options.save:
        for name, kind in MATCHED.items():
            callback = partial(match, name)
            node.create_subscription(
                kind, f"segmentation/{name}", callback, qos_profile_sensor_data
            )
        if LabelInfo is not None:
            node.create_subscription(LabelInfo, "segmentation/label_info", labels, late)
    node.create_subscription(DiagnosticArray, "/diagnostics", diagnostics, 10)
    raw = node.create_publisher(Image, "image", qos_profile_sensor_data)
    packed = node.create_publisher(CompressedImage, "image/compressed", qos_profile_sensor_data)
    lens = node.create_publisher(CameraInfo, "camera_info", qos_profile_sensor_data)
    info = CameraInfo(width=width, height=height, distortion_model="plumb_bob")
    info.k = [float(width), 0, width / 2, 0, float(width), height / 2, 0, 0, 1.0]
    while not raw.get_subscription_count() or not node.count_publishers("segmentation/mask"):
        rclpy.spin_once(node, timeout_sec=0.1)
    encodings, number, due = options.encodings.split(","), 0, time.monotonic() + SETTLING
    end = due + options.seconds
    while time.monotonic() < end + SETTLING:  # for the last answers and diagnostics
        rclpy.spin_once(node, timeout_sec=max(0.0, min(due, end + SETTLING) - time.monotonic()))
        if time.monotonic() < due or due > end:
            continue
        number += 1
        encoding = encodings[number % len(encodings)]
        sent[number] = encoding, time.monotonic()
        (packed if encoding == "compressed" else raw).publish(message_of(encoding, pixels, number))
        lens.publish(info)
        due = max(due + 1 / options.rate, time.monotonic() - 1 / options.rate)
    if options.save:
        save_topics(options.save, next(m for m in matched.values() if m.keys() == MATCHED.keys()))
    print(json.dumps({**results, "sent": number}), flush=True)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
