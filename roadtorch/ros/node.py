"""The node: subscriptions, publishers, and the loop between them."""

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
from roadtorch.base.signals import Stop
from roadtorch.camera.calibration import lens_of_info
from roadtorch.camera.camera import Camera
from roadtorch.camera.ground_grid import GridSettings, ground_grid
from roadtorch.camera.mounting import Mounting, Placing, placing_of
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.image_messages import image_of
from roadtorch.inputs.item import Item, Source
from roadtorch.road.steady import Steady, SteadySettings
from roadtorch.ros.messages import (
    diagnostics_message,
    grid_message,
    image_message,
    label_info_message,
    ros_module,
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

NAME = "roadtorch"

SECOND = 1.0  # between diagnostics
ENDING = 0.5  # seconds for callbacks that are running at the end
WAIT = 0.1  # after which a request to stop is looked for
STALE = 2.0  # seconds without an image from which diagnostics warn


class NodeParameters(Settings):
    """The parameters of the node; ROS has no missing values, so 0, NaN and "" stand for none."""

    detector: str = Field(default="fusion", description="name of the detector")
    settings: tuple[str, ...] = Field(
        default=(), strict=False, description="of the detector, KEY=VALUE"
    )
    camera: str = Field(default="", description="what roadtorch camera wrote about the camera")
    steadied: bool = Field(default=True, description="whether frames steady one another")
    height: float = Field(default=0.0, ge=0, description="of the camera, metres; 0: no grid")
    pitch: float = Field(
        default=math.nan, allow_inf_nan=True, description="degrees; NaN: from the image"
    )
    roll: float = Field(default=0.0, description="degrees")
    fov: float = Field(default=0.0, ge=0, description="degrees; 0: from camera_info")
    resolution: float = Field(default=0.1, description="metres a cell")
    range: float = Field(default=30.0, description="metres ahead")
    side: float = Field(default=15.0, description="metres left and right")
    base_frame: str = Field(default="base_link", description="frame of the grid")


def spin(words: Sequence[str], stop: Stop) -> None:
    """Run the node until somebody asks to stop; words: the arguments of ROS.

    Raises ConfigError without rclpy, and for parameters that cannot be used.
    """
    rclpy = ros_module("rclpy")
    ours = ros_module("rclpy.signals").SignalHandlerOptions.NO  # a request to stop is ours
    rclpy.init(args=[NAME, *words], signal_handler_options=ours)
    node = rclpy.create_node(NAME)
    executor = ros_module("rclpy.executors").SingleThreadedExecutor()
    executor.add_node(node)
    thread = Thread(target=_spun, args=(executor,), daemon=True)
    try:
        road = RoadNode(node, declared(node))
        thread.start()
        road.work(stop)
    finally:
        executor.shutdown(timeout_sec=ENDING)
        rclpy.try_shutdown()
        if thread.is_alive():  # a thread that Python ends within rclpy's C++ aborts the process
            thread.join(ENDING)


def _spun(executor: Any) -> None:
    """Answer subscriptions; what ends the executor while it works is its end."""
    try:
        executor.spin()
    except Exception:
        if executor.context.ok():
            raise


def declared(node: Any) -> NodeParameters:
    """The parameters as the user has set them, each declared with its default."""
    values: dict[str, Any] = {}
    for name, field in NodeParameters.model_fields.items():
        default = [""] if name == "settings" else field.default
        value = node.declare_parameter(name, default).value
        values[name] = tuple(filter(None, value)) if name == "settings" else value
    return build_settings(NodeParameters, values)


class Inbox:
    """The newest image message of a topic; ``put`` is called by the thread of the subscriptions.

    dropped: how many were replaced before anybody looked. header: std_msgs/Header of the message
    that was taken last. arrived: when that was, by the monotonic clock.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.header: Any = None
        self.arrived = 0.0
        self._newest: tuple[Any, float] | None = None
        self._changed = Condition()

    def put(self, message: Any) -> None:
        """Take a message, in the place of one that nobody has taken."""
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = message, time.monotonic()
            self._changed.notify()

    def take(self) -> Any:
        """The message, once there is one; None after ``WAIT``."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._newest, WAIT) or self._newest is None:
                return None
            (message, self.arrived), self._newest = self._newest, None
            self.header = message.header
            return message

    def source(self, topic: str, stop: Stop) -> Source:
        """The messages as a live source of frames, until somebody asks to stop."""

        def frames() -> Iterator[Item]:
            number = 0
            while not stop.asked:
                if (message := self.take()) is not None:
                    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                    read = partial(image_of, message, topic)
                    yield Item(f"{number:06d}", topic, read, number=number, stamp=stamp)
                    number += 1

        return Source("ros", topic, frames, live=True)


class RoadNode:
    """Publishers and subscriptions of a node, and what is published of each frame.

    node: of rclpy. parameters: see ``NodeParameters``.
    """

    def __init__(self, node: Any, parameters: NodeParameters) -> None:
        qos, kinds = ros_module("rclpy.qos"), ros_module("sensor_msgs.msg")
        known = Camera.read(parameters.camera) if parameters.camera else None
        settings = parse_assignments(parameters.settings)
        self.detector = load_detector(parameters.detector, camera=known, **settings)
        self.infer = Inference(self.detector, known)
        self.steady = Steady(SteadySettings()) if parameters.steadied else None
        self.node, self.parameters, self.inbox = node, parameters, Inbox()
        self.times, self.refused, self.told = deque[float](maxlen=30), 0, ""
        self.last: Detection | None = None
        self.age = 0.0  # seconds from the arrival of its message to its last answer
        self.placing, self.grid_settings = self._placing()
        newest, latched = qos.qos_profile_sensor_data, qos.QoSProfile(depth=1)
        latched.durability = qos.DurabilityPolicy.TRANSIENT_LOCAL
        node.create_subscription(kinds.Image, "image", self.inbox.put, newest)
        node.create_subscription(kinds.CompressedImage, "image/compressed", self.inbox.put, newest)
        node.create_subscription(kinds.CameraInfo, "camera_info", self._lens, newest)
        self.images = {
            topic: node.create_publisher(kinds.Image, topic, 1)
            for topic in (MASK_TOPIC, CONFIDENCE_TOPIC, OVERLAY_TOPIC)
        }
        occupancy = ros_module("nav_msgs.msg").OccupancyGrid
        self.grids = node.create_publisher(occupancy, GRID_TOPIC, latched)
        array = ros_module("diagnostic_msgs.msg").DiagnosticArray
        self.diagnostics = node.create_publisher(array, "/diagnostics", 1)
        self.labels = self._labels(latched)

    def work(self, stop: Stop) -> None:
        """Look at the newest image, publish what is found, and begin again."""
        topic = self.node.resolve_topic_name("image")
        self.node.get_logger().info(f"{self.detector.name} looks at {topic}")
        self.node.create_timer(SECOND, self._diagnose)
        source = self.inbox.source(topic, stop)
        with closing(
            detect_frames(source, self.infer, Workers(), self.steady, stop=stop)
        ) as frames:
            for frame in frames:
                if isinstance(frame.outcome, RoadtorchError):
                    self.refused += 1
                    self._warn(str(frame.outcome))
                else:
                    self._publish(frame.outcome)

    def _publish(self, detection: Detection) -> None:
        """Mask and confidence; overlay and grid where somebody listens."""
        header = self.inbox.header
        mask, confidence = mask_and_confidence(detection)
        self.images[MASK_TOPIC].publish(image_message(header, mask))
        self.images[CONFIDENCE_TOPIC].publish(image_message(header, confidence))
        if self.images[OVERLAY_TOPIC].get_subscription_count():
            self.images[OVERLAY_TOPIC].publish(image_message(header, detection.overlay()))
        if self.placing is not None and not self.placing.lacks_lens:
            self._publish_grid(header, detection)
        self.last = detection
        self.age = time.monotonic() - self.inbox.arrived
        self.times.append(time.monotonic())

    def _publish_grid(self, header: Any, detection: Detection) -> None:
        """The ground; an image that does not tell its pitch has none."""
        assert self.placing is not None
        assert detection.image is not None
        likelihood, settings = detection.likelihood, self.grid_settings
        try:
            camera, _ = self.placing(detection.image, detection.cues.get("layout"))
            road = likelihood * (detection.mask | (likelihood < settings.threshold))
            grid = ground_grid(road, camera, settings, detection.cues.get("ego"))
        except RoadtorchError as error:
            self._warn(str(error))
            return
        self.grids.publish(grid_message(header, grid, self.parameters.base_frame))

    # --- what is known of the camera ------------------------------------------------------

    def _placing(self) -> tuple[Placing | None, GridSettings]:
        """How the camera stands over the ground; None where its height is not known."""
        own = self.parameters
        cells = {name: getattr(own, name) for name in ("resolution", "range", "side")}
        values = {**cells, "threshold": self.detector.settings.threshold}
        settings = build_settings(GridSettings, values)
        if not own.height:
            return None, settings
        mounting = Mounting(
            height=own.height,
            pitch=None if math.isnan(own.pitch) else own.pitch,
            roll=own.roll,
            fov=own.fov or None,
            camera=Path(own.camera) if own.camera else None,
        )
        return placing_of(mounting, of_bags=True), settings

    def _lens(self, message: Any) -> None:
        """The lens of a CameraInfo, once."""
        if self.placing is None or not self.placing.lacks_lens:
            return
        size, topic = (message.width, message.height), self.node.resolve_topic_name("camera_info")
        try:
            if not message.k[0] > 0:
                raise ConfigError(topic, "says nothing of its camera", "calibrate it, or set fov")
            lens = lens_of_info(topic, size, [*message.k], [*message.d], message.distortion_model)
            self.placing = self.placing.through(lens)
        except RoadtorchError as error:
            self._warn(str(error))

    # --- words ----------------------------------------------------------------------------

    def _labels(self, latched: Any) -> Any:
        """The latched names of the classes; None where vision_msgs is not installed."""
        try:
            kind = ros_module("vision_msgs.msg").LabelInfo
        except ConfigError:
            self._warn(f"vision_msgs is not installed, so that {LABELS_TOPIC} is not published")
            return None
        publisher = self.node.create_publisher(kind, LABELS_TOPIC, latched)
        publisher.publish(label_info_message(self.detector.settings.threshold))
        return publisher

    def _warn(self, words: str) -> None:
        """Say it, unless it was said just before."""
        if words != self.told:
            self.told = words
            self.node.get_logger().warning(words)

    def _diagnose(self) -> None:
        """How it goes: once a second."""
        now, detection, times = time.monotonic(), self.last, [*self.times]
        silent = now - times[-1] if times else math.inf
        words = detection.doubt if detection else ""
        if detection is not None and not detection.mask.any():
            words = "no road found: nothing is free"
        if silent > STALE:
            words = f"no image on {self.node.resolve_topic_name('image')}"
        rate = (len(times) - 1) / max(times[-1] - times[0], 1e-9) if len(times) > 1 else 0.0
        values = {
            "trust": ""
            if detection is None or detection.trust is None
            else f"{detection.trust:.2f}",
            "doubt": detection.doubt if detection else "",
            "rate": f"{rate if silent <= STALE else 0.0:.1f} Hz",
            "age": f"{1000 * self.age:.0f} ms",
            "dropped": self.inbox.dropped,
            "refused": self.refused,
        }
        stamp = self.node.get_clock().now().to_msg()
        self.diagnostics.publish(diagnostics_message(stamp, words, values))
