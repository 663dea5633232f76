"""The topics of one camera: subscriptions, publishers, and the steps between them."""

import math
import time
from collections import deque
from collections.abc import Generator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

from torch import Tensor

from roadtorch.base.errors import ConfigError, RoadtorchError, to_input_error
from roadtorch.camera.calibration import lens_from_camera_info
from roadtorch.camera.ground_points import ground_points
from roadtorch.camera.mounting import PitchFilter, build_placement
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.mask import Evidence
from roadtorch.imaging.motion import flow_image
from roadtorch.road.temporal_filter import (
    Motion,
    TemporalFilter,
    TemporalFilterSettings,
    estimate_motion,
)
from roadtorch.ros.inbox import Arrival, Inbox
from roadtorch.ros.messages import (
    diagnostic_status,
    grid_message,
    image_message,
    import_ros,
    label_info_message,
    points_message,
)
from roadtorch.ros.parameters import NodeParameters
from roadtorch.run.loop import Inference
from roadtorch.run.writers.bag import (
    CONFIDENCE_TOPIC,
    GRID_TOPIC,
    LABELS_TOPIC,
    MASK_TOPIC,
    OVERLAY_TOPIC,
    POINTS_TOPIC,
    mask_and_confidence,
)
from roadtorch.run.writers.grid import make_grid

STALE_AFTER = 2.0  # seconds without an image after which diagnostics warn


class CameraTopics:
    """Subscriptions, publishers and state of a camera; topics are relative to its name, if any."""

    def __init__(
        self, node: Any, name: str, parameters: NodeParameters, inference: Inference, inbox: Inbox
    ) -> None:
        self.node, self.name, self.parameters, self.inbox = node, name, parameters, inbox
        self.inference = inference
        self.filter = TemporalFilter(TemporalFilterSettings()) if parameters.smoothing else None
        self._grey: Tensor | None = None  # of the last image
        self.times, self.failures, self.last_warning = deque[float](maxlen=30), 0, ""
        self.last_detection: Detection | None = None
        self.latency = 0.0  # seconds from the arrival of the last image to its results
        camera, grid = inference.camera, parameters.grid.model_dump(exclude_unset=True)
        has_height = "height" in grid or (camera is not None and camera.grid.height is not None)
        placement = build_placement(camera, grid, of_bags=True) if has_height else None
        self.placement = replace(placement, smooth=PitchFilter()) if placement else None
        self.topic = node.resolve_topic_name(self._relative("image"))
        messages, qos = import_ros("sensor_msgs.msg"), import_ros("rclpy.qos")
        for message_class, topic, callback in (
            (messages.Image, "image", partial(inbox.put, name)),
            (messages.CompressedImage, "image/compressed", partial(inbox.put, name)),
            (messages.CameraInfo, "camera_info", self._take_lens),
        ):
            newest = qos.qos_profile_sensor_data
            node.create_subscription(message_class, self._relative(topic), callback, newest)
        latched = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self.images = {
            topic: node.create_publisher(messages.Image, self._relative(topic), 1)
            for topic in (MASK_TOPIC, CONFIDENCE_TOPIC, OVERLAY_TOPIC)
        }
        occupancy = import_ros("nav_msgs.msg").OccupancyGrid
        self.grids = node.create_publisher(occupancy, self._relative(GRID_TOPIC), latched)
        self.clouds = node.create_publisher(messages.PointCloud2, self._relative(POINTS_TOPIC), 1)
        self.labels = self._publish_labels(latched)

    def _relative(self, topic: str) -> str:
        """Return a topic relative to the node's namespace and the camera's name."""
        return f"{self.name}/{topic.lstrip('/')}".lstrip("/")

    # --- steps --------------------------------------------------------------------------------

    @contextmanager
    def report_errors(self) -> Generator[None]:
        """Count and log an error of an image instead of raising it."""
        try:
            yield
        except Exception as error:  # one image that breaks a detector must not end the node
            self.failures += 1
            self._warn(str(to_input_error(self.topic, error)))

    def estimate_motion(self, image: Tensor) -> Motion | None:
        """Estimate the motion from an image to the last one; None without smoothing or a last."""
        if self.filter is None:
            return None
        previous, self._grey = self._grey, flow_image(image, self.filter.settings.width)
        if previous is None or previous.shape != self._grey.shape:
            return None
        return estimate_motion(previous, self._grey, self.filter.settings)

    def finish(self, arrival: Arrival, evidence: Evidence, motion: "Future[Motion | None]") -> None:
        """Decide on the mask of an image, after temporal smoothing, and publish it."""
        with self.report_errors():
            evidence = evidence._replace(motion=motion.result())
            self._publish(arrival, self.inference.conclude(evidence, self.filter))

    def _publish(self, arrival: Arrival, detection: Detection) -> None:
        """Publish mask, confidence and grid, and the overlay where it has subscribers."""
        header = arrival.message.header
        mask, confidence = mask_and_confidence(detection)
        self.images[MASK_TOPIC].publish(image_message(header, mask))
        self.images[CONFIDENCE_TOPIC].publish(image_message(header, confidence))
        if self.images[OVERLAY_TOPIC].get_subscription_count():
            self.images[OVERLAY_TOPIC].publish(image_message(header, detection.overlay()))
        if self.placement is not None and not self.placement.needs_lens:
            self._publish_grid(header, detection)
        self.last_detection = detection
        self.latency = time.monotonic() - arrival.time
        self.times.append(time.monotonic())

    def _publish_grid(self, header: Any, detection: Detection) -> None:
        """Publish the grid, and its points where somebody subscribes; warn without a pitch."""
        assert self.placement is not None
        threshold = self.inference.detector.settings.threshold
        try:
            grid, camera, _ = make_grid(self.placement, detection, threshold)
        except RoadtorchError as error:
            self._warn(str(error))
            return
        self.grids.publish(grid_message(header, grid, self.placement.settings.frame))
        if self.clouds.get_subscription_count():
            self.clouds.publish(points_message(header, ground_points(camera, grid)))

    # --- camera -----------------------------------------------------------------------------

    def _take_lens(self, message: Any) -> None:
        """Take the lens from the first CameraInfo message."""
        if self.placement is None or not self.placement.needs_lens:
            return
        topic = self.node.resolve_topic_name(self._relative("camera_info"))
        try:
            lens = lens_from_camera_info(topic, message, self.topic)
            self.placement = self.placement.with_lens(lens)
        except RoadtorchError as error:
            self._warn(str(error))

    # --- labels and diagnostics -------------------------------------------------------------

    def _publish_labels(self, latched: Any) -> Any:
        """Publish the latched label info; None where vision_msgs is not installed."""
        try:
            label_info = import_ros("vision_msgs.msg").LabelInfo
        except ConfigError:
            self._warn(f"vision_msgs is not installed: {LABELS_TOPIC} is not published")
            return None
        publisher = self.node.create_publisher(label_info, self._relative(LABELS_TOPIC), latched)
        publisher.publish(label_info_message(self.inference.detector.settings.threshold))
        return publisher

    def _warn(self, message: str) -> None:
        """Log a warning, unless it repeats the last one."""
        if message != self.last_warning:
            self.last_warning = message
            self.node.get_logger().warning(message)

    def diagnostics(self) -> Any:
        """Return the diagnostic_msgs/DiagnosticStatus of the camera."""
        detection, times = self.last_detection, [*self.times]
        silence = time.monotonic() - times[-1] if times else math.inf
        warning = detection.doubt if detection else ""
        if detection is not None and not detection.mask.any():
            warning = "no road found: nothing is free"
        if silence > STALE_AFTER:
            warning = f"no image on {self.topic}"
        rate = (len(times) - 1) / max(times[-1] - times[0], 1e-9) if len(times) > 1 else 0.0
        trust = detection.trust if detection else None
        values = {
            "trust": "" if trust is None else f"{trust:.2f}",
            "doubt": detection.doubt if detection else "",
            "rate": f"{rate if silence <= STALE_AFTER else 0.0:.1f} Hz",
            "age": f"{1000 * self.latency:.0f} ms",
            "dropped": self.inbox.dropped[self.name],
            "refused": self.failures,
        }
        return diagnostic_status(self.name or "road", warning, values)
