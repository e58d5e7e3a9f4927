# SPDX-License-Identifier: Apache-2.0
"""A live session as ROS 2 topics, with modules in the place of rclpy and the messages."""

from __future__ import annotations

import array
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.live.page import save_snapshot
from taccel_lab.calibration.live.reader import LiveReader
from taccel_lab.calibration.live.ros import RosPublisher
from taccel_lab.calibration.live.run import live_session, run_together
from taccel_lab.errors import InputError
from tests.calibration.depth.test_depth import grey_unit
from tests.calibration.live.test_live import Watching
from tests.calibration.record.sessions import SteeredCamera
from tests.support.small_captures import everything_below, never


class Image(SimpleNamespace):
    def __init__(self) -> None:
        super().__init__(header=SimpleNamespace(), data=array.array("B"))

    def pixels(self) -> np.ndarray:
        """As cv_bridge reads it."""
        kind, channels = {"rgb8": (np.uint8, 3), "32FC1": (np.float32, 1)}[self.encoding]
        assert self.step == self.width * channels * np.dtype(kind).itemsize
        shape = (self.height, self.width, channels)
        return np.frombuffer(self.data.tobytes(), kind).reshape(shape)


class Float32(SimpleNamespace):
    pass


class WrenchStamped(SimpleNamespace):
    def __init__(self) -> None:
        wrench = SimpleNamespace(force=SimpleNamespace(), torque=SimpleNamespace())
        super().__init__(header=SimpleNamespace(), wrench=wrench)


class Time(float):
    def __sub__(self, other: float) -> Time:
        return Time(float(self) - other)

    def to_msg(self) -> float:
        return float(self)


class Ros(ModuleType):
    """rclpy and its one node, which keeps what is published, by topic."""

    def __init__(self) -> None:
        super().__init__("rclpy")
        self.up, self.ended, self.published, self.logged = False, False, {}, []

    def ok(self) -> bool:
        return self.up

    def init(self) -> None:
        self.up = True

    def shutdown(self) -> None:
        self.up = False

    def create_node(self, name: str) -> Ros:
        self.name = name
        return self

    def create_publisher(self, kind: type, topic: str, queue: int) -> SimpleNamespace:
        kept = self.published.setdefault(topic, [])

        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            kept.append(message)

        return SimpleNamespace(publish=publish)

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: Time(100.0))

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.logged.append)

    def destroy_node(self) -> None:
        self.ended = True

    def newest(self, *names: str) -> list[Any]:
        return [self.published[f"tactile/left/{name}"][-1] for name in names]


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Ros:
    rclpy = Ros()
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    for name, contents in {
        "rclpy.duration": {"Duration": lambda nanoseconds: 1e-9 * nanoseconds},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"Image": Image},
        "std_msgs": {},
        "std_msgs.msg": {"Float32": Float32},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"WrenchStamped": WrenchStamped},
    }.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    return rclpy


@pytest.mark.thorough
def test_readings_are_published_with_standard_messages(ros: Ros, tmp_path: Path) -> None:
    unit = grey_unit()
    camera = SteeredCamera(tmp_path, unit.rest, noise=0.5)
    camera.image = unit.pressed
    publisher, watching = RosPublisher("tactile/left"), Watching()
    told = {"Fx [N]": 0.25, "Fx +- [N]": 0.1, "Fy [N]": -0.5}

    def reader(background: np.ndarray) -> LiveReader:
        return LiveReader(unit.profile, background, force=lambda image, rest: told)

    watchers, untouched = [publisher, watching], unit.rest.astype(np.float32)
    session = live_session(reader, lambda: camera, watchers, background=untouched, frames=2)
    (result,) = run_together([session])
    reading = watching.readings[-1]
    assert ros.name == "taccel_lab_tactile_left"
    image, depth, contact, wrench = ros.newest("image", "depth", "contact", "wrench")
    np.testing.assert_array_equal(image.pixels(), reading.image)
    np.testing.assert_array_equal(
        depth.pixels()[..., 0], reading.reading.depth_m.astype(np.float32)
    )
    assert 1e-4 < depth.pixels().max() < 1e-2  # Metres.
    assert contact.data == pytest.approx(1e-6 * reading.press.area_mm2)
    force, torque = wrench.wrench.force, wrench.wrench.torque
    assert (force.x, force.y, force.z) == pytest.approx((0.25, -0.5, -reading.press.force_n))
    x, y = (1e-3 * at for at in reading.press.center_mm)
    assert (torque.x, torque.y) == pytest.approx(np.cross([x, y, 0], [0, 0, force.z])[:2])
    assert np.isnan(torque.z)
    for message in (image, depth, wrench):
        assert message.header.frame_id == "tactile/left/gel"
        came = 100 - sum(reading.stages_s.values())
        assert message.header.stamp == pytest.approx(came, abs=1e-6)
    publisher.tell("Touch nothing")
    assert ros.logged[-1] == "Touch nothing"
    assert result.reader is not None and reading.reading is not None
    refused = replace(reading, refused="too steep", reading=None, forces={})
    publisher.show(refused, result.reader, result.latency)
    depth, wrench = ros.newest("depth", "wrench")
    force = wrench.wrench.force
    assert np.isnan(depth.pixels()).all() and np.isnan([force.x, force.y, force.z]).all()
    assert not publisher.stopped()
    publisher.close()
    assert ros.ended and publisher.stopped()
    # A snapshot of the same reading.
    kept = tmp_path / "kept"
    for number, each in enumerate((reading, reading, refused)):
        assert save_snapshot(each, kept).name == f"snapshot_{number:03d}_image.png"
    with np.load(kept / "snapshot_001.npz") as arrays:
        np.testing.assert_allclose(arrays["depth_m"], reading.reading.depth_m, rtol=1e-6)
        assert arrays["pressure_pa"].max() > 0
    assert [path.name for path in kept.glob("*002*")] == ["snapshot_002_image.png"]
    # What is there of another stays, and of one that cannot be written nothing.
    (kept / "snapshot_004.json").write_text("{}")
    before = everything_below(kept)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("taccel_lab.reading.reading.save_figure", never)
        with pytest.raises(AssertionError):
            save_snapshot(reading, kept)
    assert everything_below(kept) == before
    assert save_snapshot(reading, kept).name == "snapshot_005_image.png"


def test_wrong_names_and_missing_ros_are_sentences(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("", "/left", "1left", "left-hand", "a//b"):
        with pytest.raises(InputError, match="letters, digits and _ are allowed"):
            RosPublisher(name)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(InputError, match="needs ROS 2 in this environment"):
        RosPublisher("left")
