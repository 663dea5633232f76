"""The ROS 2 node: one network for the images of one or several cameras.

Images are decoded and analysed in this thread. A second one estimates their motion meanwhile, and
decides and publishes their masks while the next image is analysed.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from threading import Thread
from typing import Any

import torch

from roadtorch.base.errors import InputError
from roadtorch.base.settings import parse_assignments
from roadtorch.base.signals import StopRequest
from roadtorch.camera.camera import Camera
from roadtorch.detectors.catalogue import load_detector
from roadtorch.inputs.image_messages import decode_message
from roadtorch.ros.camera_topics import CameraTopics
from roadtorch.ros.inbox import Inbox
from roadtorch.ros.messages import import_ros
from roadtorch.ros.parameters import NodeParameters, declare_parameters
from roadtorch.run.loop import Inference

NODE_NAME = "roadtorch"

DIAGNOSTICS_PERIOD = 1.0  # seconds
STOP_TIMEOUT = 0.5  # seconds for running callbacks when the node stops


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


class RoadNode:
    """Cameras of an rclpy node, and the detection of the road in their images."""

    def __init__(self, node: Any, parameters: Mapping[str, NodeParameters]) -> None:
        self.node, self.inbox = node, Inbox(parameters)
        inferences = load_inferences(parameters)
        self.cameras = {
            name: CameraTopics(node, name, values, inferences[values.camera], self.inbox)
            for name, values in parameters.items()
        }
        array = import_ros("diagnostic_msgs.msg").DiagnosticArray
        self.diagnostics = node.create_publisher(array, "/diagnostics", 1)

    def run(self, stop: StopRequest) -> None:
        """Detect the road in the images and publish it, until a stop is requested."""
        for camera in self.cameras.values():
            name = camera.inference.detector.name
            self.node.get_logger().info(f"{name} subscribes to {camera.topic}")
        self.node.create_timer(DIAGNOSTICS_PERIOD, self._publish_diagnostics)
        with ThreadPoolExecutor(1) as helper:
            finish: Future[None] | None = None
            while not stop.requested:
                if (arrival := self.inbox.take()) is None:
                    continue
                camera = self.cameras[arrival.camera]
                with camera.report_errors():
                    image = decode_message(arrival.message, camera.topic)
                    motion = helper.submit(camera.estimate_motion, image)
                    evidence = camera.inference.find_evidence(image)
                    if finish is not None:
                        finish.result()  # no more than one image ahead
                    finish = helper.submit(camera.finish, arrival, evidence, motion)

    def _publish_diagnostics(self) -> None:
        """Publish a status for each camera."""
        message = self.diagnostics.msg_type()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.status = [camera.diagnostics() for camera in self.cameras.values()]
        self.diagnostics.publish(message)


def load_inferences(parameters: Mapping[str, NodeParameters]) -> dict[str, Inference]:
    """Load a detector for each camera file, "" for none; they share their networks."""
    inferences: dict[str, Inference] = {}
    for values in parameters.values():
        if values.camera in inferences:
            continue
        camera = Camera.read(values.camera) if values.camera else None
        settings = parse_assignments(values.settings)
        detector = load_detector(values.detector, camera=camera, runtime=values.runtime, **settings)
        for first in list(inferences.values())[:1]:
            for name, network in first.detector.analysis.named_children():
                setattr(detector.analysis, name, network)
        with suppress(InputError):  # of another aspect ratio than the camera's
            detector.detect(torch.zeros(3, 480, 640))  # the first image takes several times longer
        inferences[values.camera] = Inference(detector, camera)
    return inferences
