"""The ROS 2 node: subscriptions, publishers and the detection loop."""

import math
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from threading import Condition, Thread
from typing import Any

from pydantic import Field

from roadtorch.base.errors import ConfigError, RoadtorchError
from roadtorch.base.settings import Settings, build_settings, parse_assignments
from roadtorch.base.signals import StopRequest
from roadtorch.camera.calibration import lens_from_camera_info
from roadtorch.camera.camera import Camera
from roadtorch.camera.ground_grid import GridSettings, ground_grid
from roadtorch.camera.mounting import CameraPlacement, Mounting, build_placement
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.image_messages import decode_message
from roadtorch.inputs.item import Item, Source
from roadtorch.road.temporal_filter import TemporalFilter, TemporalFilterSettings
from roadtorch.ros.messages import (
    diagnostics_message,
    grid_message,
    image_message,
    import_ros,
    label_info_message,
)
from roadtorch.run.loop import Inference, detect_frames
from roadtorch.run.workers import Workers
from roadtorch.run.writers.bag import (
    CONFIDENCE_TOPIC,
    GRID_TOPIC,
    LABELS_TOPIC,
    MASK_TOPIC,
    OVERLAY_TOPIC,
    mask_and_confidence,
)

NODE_NAME = "roadtorch"

DIAGNOSTICS_PERIOD = 1.0  # seconds
STOP_TIMEOUT = 0.5  # seconds for running callbacks when the node stops
POLL_PERIOD = 0.1  # seconds between checks for a stop request
STALE_AFTER = 2.0  # seconds without an image after which diagnostics warn


class NodeParameters(Settings):
    """Parameters of the node; 0, NaN and "" stand for unset, as ROS has no null."""

    detector: str = Field(default="fusion", description="name of the detector")
    settings: tuple[str, ...] = Field(
        default=(), strict=False, description="settings of the detector, KEY=VALUE"
    )
    camera: str = Field(default="", description="camera file written by roadtorch camera")
    smoothing: bool = Field(default=True, description="temporal smoothing of the likelihood")
    height: float = Field(
        default=0.0, ge=0, description="height of the camera above the ground, metres; 0: no grid"
    )
    pitch: float = Field(
        default=math.nan,
        allow_inf_nan=True,
        description="pitch of the camera, degrees; NaN: from each image",
    )
    roll: float = Field(default=0.0, description="roll of the camera, degrees")
    fov: float = Field(
        default=0.0, ge=0, description="horizontal field of view, degrees; 0: from camera_info"
    )
    resolution: float = Field(default=0.1, description="metres per cell of the grid")
    range: float = Field(default=30.0, description="extent of the grid ahead, metres")
    side: float = Field(default=15.0, description="extent of the grid to either side, metres")
    base_frame: str = Field(default="base_link", description="frame of the grid")


def spin(arguments: Sequence[str], stop: StopRequest) -> None:
    """Run the node with ROS arguments until a stop is requested; ConfigError without rclpy."""
    rclpy = import_ros("rclpy")
    no_handlers = import_ros("rclpy.signals").SignalHandlerOptions.NO  # ``stop`` handles signals
    rclpy.init(args=[NODE_NAME, *arguments], signal_handler_options=no_handlers)
    node = rclpy.create_node(NODE_NAME)
    executor = import_ros("rclpy.executors").SingleThreadedExecutor()
    executor.add_node(node)
    thread = Thread(target=_spin_executor, args=(executor,), daemon=True)
    try:
        road = RoadNode(node, declare_parameters(node))
        thread.start()
        road.run(stop)
    finally:
        executor.shutdown(timeout_sec=STOP_TIMEOUT)
        rclpy.try_shutdown()
        # A thread that Python ends inside rclpy's C++ code aborts the process.
        if thread.is_alive():
            thread.join(STOP_TIMEOUT)


def _spin_executor(executor: Any) -> None:
    """Run the executor; errors caused by its shutdown are ignored."""
    try:
        executor.spin()
    except Exception:
        if executor.context.ok():
            raise


def declare_parameters(node: Any) -> NodeParameters:
    """Declare all parameters with their defaults, and return their values."""
    values: dict[str, Any] = {}
    for name, field in NodeParameters.model_fields.items():
        default = [""] if name == "settings" else field.default
        value = node.declare_parameter(name, default).value
        values[name] = tuple(filter(None, value)) if name == "settings" else value
    return build_settings(NodeParameters, values)


class Inbox:
    """A queue of one image message, the newest; ``put`` is called by the executor's thread."""

    def __init__(self) -> None:
        self.dropped = 0  # messages replaced before they were taken
        self.header: Any = None  # std_msgs/Header of the last message taken
        self.arrival = 0.0  # time of its arrival, ``time.monotonic``
        self._newest: tuple[Any, float] | None = None
        self._changed = Condition()

    def put(self, message: Any) -> None:
        """Store a message, replacing one that was not taken."""
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = message, time.monotonic()
            self._changed.notify()

    def take(self) -> Any:
        """Wait for a message and return it; None after ``POLL_PERIOD``."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest, POLL_PERIOD)
            if self._newest is None:
                return None
            (message, self.arrival), self._newest = self._newest, None
            self.header = message.header
            return message

    def source(self, topic: str, stop: StopRequest) -> Source:
        """Return the messages as a live source of frames, until a stop is requested."""

        def frames() -> Iterator[Item]:
            number = 0
            while not stop.requested:
                if (message := self.take()) is not None:
                    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                    read = partial(decode_message, message, topic)
                    yield Item(f"{number:06d}", topic, read, number=number, stamp=stamp)
                    number += 1

        return Source("ros", topic, frames, live=True)


class RoadNode:
    """Subscriptions and publishers of an rclpy node, and the detection of its images."""

    def __init__(self, node: Any, parameters: NodeParameters) -> None:
        qos, kinds = import_ros("rclpy.qos"), import_ros("sensor_msgs.msg")
        camera = Camera.read(parameters.camera) if parameters.camera else None
        settings = parse_assignments(parameters.settings)
        self.detector = load_detector(parameters.detector, camera=camera, **settings)
        self.infer = Inference(self.detector, camera)
        temporal_filter = TemporalFilter(TemporalFilterSettings())
        self.temporal_filter = temporal_filter if parameters.smoothing else None
        self.node, self.parameters, self.inbox = node, parameters, Inbox()
        self.times, self.failures, self.last_warning = deque[float](maxlen=30), 0, ""
        self.last_detection: Detection | None = None
        self.latency = 0.0  # seconds from the arrival of the last image to its results
        self.placement, self.grid_settings = self._make_placement()
        newest, latched = qos.qos_profile_sensor_data, qos.QoSProfile(depth=1)
        latched.durability = qos.DurabilityPolicy.TRANSIENT_LOCAL
        node.create_subscription(kinds.Image, "image", self.inbox.put, newest)
        node.create_subscription(kinds.CompressedImage, "image/compressed", self.inbox.put, newest)
        node.create_subscription(kinds.CameraInfo, "camera_info", self._take_lens, newest)
        self.images = {
            topic: node.create_publisher(kinds.Image, topic, 1)
            for topic in (MASK_TOPIC, CONFIDENCE_TOPIC, OVERLAY_TOPIC)
        }
        occupancy = import_ros("nav_msgs.msg").OccupancyGrid
        self.grids = node.create_publisher(occupancy, GRID_TOPIC, latched)
        array = import_ros("diagnostic_msgs.msg").DiagnosticArray
        self.diagnostics = node.create_publisher(array, "/diagnostics", 1)
        self.labels = self._publish_labels(latched)

    def run(self, stop: StopRequest) -> None:
        """Detect the road in the newest image and publish it, until a stop is requested."""
        topic = self.node.resolve_topic_name("image")
        self.node.get_logger().info(f"{self.detector.name} subscribes to {topic}")
        self.node.create_timer(DIAGNOSTICS_PERIOD, self._publish_diagnostics)
        source = self.inbox.source(topic, stop)
        results = detect_frames(source, self.infer, Workers(), self.temporal_filter, stop=stop)
        with closing(results) as frames:
            for frame in frames:
                if isinstance(frame.outcome, RoadtorchError):
                    self.failures += 1
                    self._warn(str(frame.outcome))
                else:
                    self._publish(frame.outcome)

    def _publish(self, detection: Detection) -> None:
        """Publish mask, confidence and grid, and the overlay where it has subscribers."""
        header = self.inbox.header
        mask, confidence = mask_and_confidence(detection)
        self.images[MASK_TOPIC].publish(image_message(header, mask))
        self.images[CONFIDENCE_TOPIC].publish(image_message(header, confidence))
        if self.images[OVERLAY_TOPIC].get_subscription_count():
            self.images[OVERLAY_TOPIC].publish(image_message(header, detection.overlay()))
        if self.placement is not None and not self.placement.needs_lens:
            self._publish_grid(header, detection)
        self.last_detection = detection
        self.latency = time.monotonic() - self.inbox.arrival
        self.times.append(time.monotonic())

    def _publish_grid(self, header: Any, detection: Detection) -> None:
        """Publish the ground grid; warn where the pitch of the image is unknown."""
        assert self.placement is not None
        assert detection.image is not None
        likelihood, settings = detection.likelihood, self.grid_settings
        try:
            camera, _ = self.placement(detection.image, detection.cues.get("layout"))
            road = likelihood * (detection.mask | (likelihood < settings.threshold))
            grid = ground_grid(road, camera, settings, detection.cues.get("ego"))
        except RoadtorchError as error:
            self._warn(str(error))
            return
        self.grids.publish(grid_message(header, grid, self.parameters.base_frame))

    # --- camera -----------------------------------------------------------------------------

    def _make_placement(self) -> tuple[CameraPlacement | None, GridSettings]:
        """Return the pose of the camera, None without a height, and the settings of the grid."""
        values = self.parameters
        cells = {name: getattr(values, name) for name in ("resolution", "range", "side")}
        threshold = self.detector.settings.threshold
        settings = build_settings(GridSettings, {**cells, "threshold": threshold})
        if not values.height:
            return None, settings
        mounting = Mounting(
            height=values.height,
            pitch=None if math.isnan(values.pitch) else values.pitch,
            roll=values.roll,
            fov=values.fov or None,
            camera=Path(values.camera) if values.camera else None,
        )
        return build_placement(mounting, of_bags=True), settings

    def _take_lens(self, message: Any) -> None:
        """Take the lens from the first CameraInfo message."""
        if self.placement is None or not self.placement.needs_lens:
            return
        size, topic = (message.width, message.height), self.node.resolve_topic_name("camera_info")
        try:
            if not message.k[0] > 0:
                raise ConfigError(topic, "has no calibration", "calibrate the camera, or set fov")
            lens = lens_from_camera_info(
                topic, size, [*message.k], [*message.d], message.distortion_model
            )
            self.placement = self.placement.with_lens(lens)
        except RoadtorchError as error:
            self._warn(str(error))

    # --- labels and diagnostics -------------------------------------------------------------

    def _publish_labels(self, latched: Any) -> Any:
        """Publish the latched label info; None where vision_msgs is not installed."""
        try:
            kind = import_ros("vision_msgs.msg").LabelInfo
        except ConfigError:
            self._warn(f"vision_msgs is not installed: {LABELS_TOPIC} is not published")
            return None
        publisher = self.node.create_publisher(kind, LABELS_TOPIC, latched)
        publisher.publish(label_info_message(self.detector.settings.threshold))
        return publisher

    def _warn(self, message: str) -> None:
        """Log a warning, unless it repeats the last one."""
        if message != self.last_warning:
            self.last_warning = message
            self.node.get_logger().warning(message)

    def _publish_diagnostics(self) -> None:
        """Publish diagnostics."""
        detection, times = self.last_detection, [*self.times]
        silence = time.monotonic() - times[-1] if times else math.inf
        warning = detection.doubt if detection else ""
        if detection is not None and not detection.mask.any():
            warning = "no road found: nothing is free"
        if silence > STALE_AFTER:
            warning = f"no image on {self.node.resolve_topic_name('image')}"
        rate = (len(times) - 1) / max(times[-1] - times[0], 1e-9) if len(times) > 1 else 0.0
        trust = detection.trust if detection else None
        values = {
            "trust": "" if trust is None else f"{trust:.2f}",
            "doubt": detection.doubt if detection else "",
            "rate": f"{rate if silence <= STALE_AFTER else 0.0:.1f} Hz",
            "age": f"{1000 * self.latency:.0f} ms",
            "dropped": self.inbox.dropped,
            "refused": self.failures,
        }
        stamp = self.node.get_clock().now().to_msg()
        self.diagnostics.publish(diagnostics_message(stamp, warning, values))
