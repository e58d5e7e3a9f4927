# SPDX-License-Identifier: Apache-2.0
"""What a live session reads, as topics of ROS 2 with standard messages, in SI units (REP 103).

rclpy and the messages come with ROS 2, not from PyPI; their classes are documented at
docs.ros.org/en/jazzy/p (sensor_msgs/Image, geometry_msgs/WrenchStamped, std_msgs).
"""

from __future__ import annotations

import array
import re
import sys
from importlib import import_module
from typing import Any

import numpy as np

from taccel_lab.calibration.live.reader import LiveReader, LiveReading
from taccel_lab.calibration.live.run import Latency
from taccel_lab.errors import InputError

QUEUE = 10
"""Messages that wait for a slow subscriber."""
MODULES = ("rclpy", "rclpy.duration", "sensor_msgs.msg", "geometry_msgs.msg", "std_msgs.msg")
TOPICS = ("image", "depth", "contact", "wrench")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")


class RosPublisher:
    """A ``LiveWatcher`` that publishes every reading under ``NAME``:

    - ``image``, sensor_msgs/Image, rgb8: the frame;
    - ``depth``, sensor_msgs/Image, 32FC1: how far the face is pressed in [m], NaN where the frame
      is refused;
    - ``contact``, std_msgs/Float32: area in contact [m2], NaN where it is not known;
    - ``wrench``, geometry_msgs/WrenchStamped: of the tool on the gel about the gel frame's origin
      [N, N m], z out of the gel; components that the profile does not tell are NaN.

    The stamp is the time at which the frame came; the frame is ``NAME/gel``.
    """

    def __init__(self, name: str) -> None:
        """Start a node. Raises InputError for a name that ROS does not allow, and without ROS."""
        if not _NAME.fullmatch(name):
            raise InputError(
                f"--ros is {name!r}; letters, digits and _ are allowed, parted by /, each part "
                "beginning with a letter"
            )
        try:
            rclpy, duration, sensor, geometry, std = (import_module(name) for name in MODULES)
        except ImportError as error:
            raise InputError(
                f"--ros needs ROS 2 in this environment ({error}): source its setup.bash before "
                "taccel-lab starts, with the Python that it is built for"
            ) from None
        self._rclpy, self._frame_id = rclpy, f"{name}/gel"
        self._duration, self._image = duration.Duration, sensor.Image
        self._float, self._wrench = std.Float32, geometry.WrenchStamped
        self._began = not rclpy.ok()
        if self._began:
            rclpy.init()
        self._node = rclpy.create_node(f"taccel_lab_{name.replace('/', '_')}")
        kinds = (self._image, self._image, self._float, self._wrench)
        self._topics = {
            topic: self._node.create_publisher(kind, f"{name}/{topic}", QUEUE)
            for topic, kind in zip(TOPICS, kinds, strict=True)
        }

    def show(self, reading: LiveReading, reader: LiveReader, latency: Latency) -> None:
        """Publish a reading."""
        taken = self._node.get_clock().now() - self._duration(
            nanoseconds=round(1e9 * sum(reading.stages_s.values()))
        )
        stamp = taken.to_msg()
        self._topics["image"].publish(self._picture(reading.image, "rgb8", stamp))
        if reading.reading is not None or reading.refused:
            depth = np.full(reading.image.shape[:2], np.nan, np.float32)
            if reading.reading is not None:
                depth = reading.reading.depth_m.astype(np.float32)
            self._topics["depth"].publish(self._picture(depth, "32FC1", stamp))
        area_mm2 = np.nan if reading.press is None else reading.press.area_mm2
        self._topics["contact"].publish(self._float(data=float(1e-6 * area_mm2)))
        self._topics["wrench"].publish(self._wrench_of(reading, stamp))

    def tell(self, text: str) -> None:
        """What goes on, into the node's log."""
        if text:
            self._node.get_logger().info(text)

    def wants_background(self) -> bool:
        return False

    def stopped(self) -> bool:
        """Whether ROS was shut down."""
        return not self._rclpy.ok()

    def close(self) -> None:
        """End the node, and ROS where this node was its first: close that one last."""
        self._node.destroy_node()
        if self._began and self._rclpy.ok():
            self._rclpy.shutdown()

    def _picture(self, levels: np.ndarray, encoding: str, stamp: Any) -> Any:
        message = self._image()
        message.header.stamp, message.header.frame_id = stamp, self._frame_id
        message.height, message.width = levels.shape[:2]
        message.encoding, message.is_bigendian = encoding, sys.byteorder == "big"
        content = np.ascontiguousarray(levels)
        message.step = content.strides[0]
        message.data = array.array("B", content.tobytes())  # Set without a look at each byte.
        return message

    def _wrench_of(self, reading: LiveReading, stamp: Any) -> Any:
        message = self._wrench()
        message.header.stamp, message.header.frame_id = stamp, self._frame_id
        force, torque = message.wrench.force, message.wrench.torque
        forces = reading.forces
        force.x, force.y = (float(forces.get(f"F{axis} [N]", np.nan)) for axis in "xy")
        force.z = torque.x = torque.y = torque.z = np.nan
        if reading.press is not None:
            x_mm, y_mm = reading.press.center_mm or (0.0, 0.0)
            force.z = -reading.press.force_n
            # About the origin, of a normal force at the centre of pressure.
            torque.x, torque.y = 1e-3 * y_mm * force.z, -1e-3 * x_mm * force.z
        elif "Fz [N]" in forces:
            force.z = -float(forces["Fz [N]"])
        return message
