# SPDX-License-Identifier: Apache-2.0
"""Cameras are found by what stays with them, opened, locked as far as they hold it; replays."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture.camera.camera import (
    CameraLostError,
    ControlValues,
    Framing,
    Gap,
    Shot,
    shots,
)
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera
from taccel_lab.calibration.capture.camera.uvc import (
    MANUAL_EXPOSURE,
    Device,
    UvcCamera,
    find_device,
    list_devices,
)
from taccel_lab.errors import InputError
from tests.fuzz.samples.captures import write_video
from tests.support.capture_sets import CaptureMaker, spread_circles, write_image

MINI = "usb-Arducam_GelSight_Mini_28C2AUAH-video-index0"
DIGIT = "usb-Facebook_DIGIT_D20025-video-index0"


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A /dev and a /sys with a GelSight Mini and a DIGIT, and a node that gives no images."""
    by_id = tmp_path / "dev/v4l/by-id"
    by_id.mkdir(parents=True)
    for name, node, serial in ((MINI, "video2", "28C2AUAH"), (DIGIT, "video0", "D20025")):
        (tmp_path / "dev" / node).touch()
        (by_id / name).symlink_to(f"../../{node}")
        device = tmp_path / "sys/devices/usb" / node
        (device / "interface").mkdir(parents=True)
        (device / "serial").write_text(serial + "\n")
        card = tmp_path / "sys/class/video4linux" / node
        card.mkdir(parents=True)
        (card / "name").write_text(name.split("_")[1] + "\n")
        (card / "device").symlink_to(device / "interface")
    (tmp_path / "dev/video1").touch()
    (by_id / DIGIT.replace("index0", "index1")).symlink_to("../../video1")
    return tmp_path


def test_cameras_are_listed_with_serial_numbers(machine: Path) -> None:
    found = {device.id: device for device in list_devices(machine)}
    assert set(found) == {MINI, DIGIT}
    assert found[DIGIT].node == "/dev/video0" and found[DIGIT].serial == "D20025"
    assert found[MINI].name == "GelSight"


@pytest.mark.parametrize("wanted", [DIGIT, "D20025", "digit", "/dev/video0", "d2002"])
def test_a_camera_is_found_by_any_of_its_names(machine: Path, wanted: str) -> None:
    assert find_device(wanted, machine).id == DIGIT


def test_a_name_that_several_have_or_none_is_refused(machine: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"several.*{DIGIT}"):
        find_device("usb", machine)
    with pytest.raises(InputError, match=f"no camera matches.*{MINI}"):
        find_device("D99999", machine)
    with pytest.raises(InputError, match="no camera is plugged in"):
        find_device("D20025", tmp_path / "empty")


class FakeCapture:
    """A ``cv2.VideoCapture`` that takes values as some drivers do."""

    def __init__(self, *, opens: bool = True, keeps_auto: bool = False, frames: int = 3) -> None:
        self.opens, self.keeps_auto, self.left = opens, keeps_auto, frames
        self.released, self.taken_s = False, 0.0
        self.values: dict[int, float] = {
            cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
            cv2.CAP_PROP_EXPOSURE: 156.0,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
            cv2.CAP_PROP_FRAME_WIDTH: 640.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
        }

    def isOpened(self) -> bool:
        return self.opens

    def set(self, key: int, value: float) -> bool:
        if key == cv2.CAP_PROP_AUTO_WB and self.keeps_auto:
            return True  # Says yes, does nothing.
        if key == cv2.CAP_PROP_EXPOSURE:
            value = round(value / 4) * 4  # Steps of its own.
        if key in self.values:
            self.values[key] = value
        return key in self.values

    def get(self, key: int) -> float:
        if key == cv2.CAP_PROP_POS_MSEC:
            return 1e3 * self.taken_s
        return self.values.get(key, -1.0)

    def read(self) -> tuple[bool, Any]:
        self.left -= 1
        self.taken_s = time.monotonic() - 0.03
        return (self.left >= 0), np.full((480, 640, 3), (10, 20, 30), np.uint8)

    def release(self) -> None:
        self.released = True


DEVICE = Device(DIGIT, "/dev/video0", "DIGIT", "D20025")


def test_controls_are_locked_and_read_back() -> None:
    capture = FakeCapture()
    camera = UvcCamera(DEVICE, open_capture=lambda _: capture)
    exposure, gain, balance = camera.lock(ControlValues())
    assert capture.values[cv2.CAP_PROP_AUTO_EXPOSURE] == MANUAL_EXPOSURE
    assert exposure.held and "156" in exposure.text
    assert gain.held is None and "no such control" in gain.text
    assert balance.held and "4600" in balance.text
    assert camera.lock(ControlValues(exposure=201.0))[0].held  # 200: a step of the driver's
    assert not camera.lock(ControlValues(exposure=1.0))[0].held


def test_a_control_that_does_not_hold_is_told() -> None:
    camera = UvcCamera(DEVICE, open_capture=lambda _: FakeCapture(keeps_auto=True))
    balance = camera.lock(ControlValues())[2]
    assert balance.held is False and "cannot be locked" in balance.text


def test_frames_are_rgb_with_the_drivers_time() -> None:
    capture = FakeCapture(frames=1)
    camera = UvcCamera(DEVICE, open_capture=lambda _: capture)
    shot = camera.read()
    assert shot.time_s == pytest.approx(capture.taken_s, abs=1e-6)
    assert tuple(shot.image[0, 0]) == (30, 20, 10)
    with pytest.raises(CameraLostError, match="no frames"):
        camera.read()


def test_what_does_not_open_or_has_no_such_size_is_told() -> None:
    with pytest.raises(CameraLostError, match="group video"):
        UvcCamera(DEVICE, open_capture=lambda _: FakeCapture(opens=False))

    class Fixed(FakeCapture):
        def set(self, key: int, value: float) -> bool:
            return False

    capture = Fixed()
    with pytest.raises(InputError, match="640x480"):
        UvcCamera(DEVICE, (320, 240), open_capture=lambda _: capture)
    assert capture.released


@pytest.mark.thorough
def test_files_are_replayed(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi")
    (tmp_path / "images").mkdir()
    for k in (2, 10, 1):
        write_image(tmp_path / "images" / f"f_{k}.png", _plain(k))
    camera = open_camera(str(tmp_path / "images"))
    assert [int(_next(camera).image[0, 0, 0]) for _ in range(3)] == [1, 2, 10]
    assert camera.read() is None
    assert open_camera(str(tmp_path / "a.avi")).read() is not None
    with pytest.raises(InputError, match="no images"):
        (tmp_path / "none").mkdir()
        open_camera(str(tmp_path / "none"))


def test_a_capture_folder_is_pressed_again(tmp_path: Path) -> None:
    folder = CaptureMaker(circles=spread_circles(2)).write(tmp_path / "set")
    camera = open_camera(
        str(folder), None, CameraReplay(fps=10, rest_s=1.0, hold_s=0.5, blend_s=0.2)
    )
    frames = []
    while (shot := camera.read()) is not None:
        frames.append(shot)
    assert len(frames) == 10 + 2 * (5 + 2 * 1 + 5)
    assert frames[1].time_s - frames[0].time_s == pytest.approx(0.1)


def test_a_lost_camera_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taccel_lab.calibration.capture.camera.camera.AGAIN_S", 0.0)
    captures = [FakeCapture(frames=2), FakeCapture(frames=2)]
    opened: list[str] = []

    def open_() -> UvcCamera:
        if not captures:
            raise CameraLostError("still gone")
        return UvcCamera(DEVICE, open_capture=lambda _: captures.pop())

    stream = shots(open_, lambda camera: opened.append(camera.info.id))
    kinds = [type(next(stream)) for _ in range(8)]
    stream.close()
    assert kinds == [Shot, Shot, Gap, Shot, Shot, Gap, Gap, Gap] and len(opened) == 2


def test_framing_cuts_and_shrinks_and_refuses_what_does_not_fit() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    image[100:, 200:] = 200
    kept = Framing.parse("200,100,400x300", "200x150").apply(image)
    assert kept.shape == (150, 200, 3) and (kept == 200).all()
    with pytest.raises(InputError, match="reaches to"):
        Framing.parse("300,0,400x300", None).apply(image)
    with pytest.raises(InputError, match="both sides alike"):
        Framing.parse(None, "100x100").apply(image)
    with pytest.raises(InputError, match="--crop is"):
        Framing.parse("1,2,3", None)


def _plain(level: int) -> np.ndarray:
    return np.full((40, 50, 3), level, np.uint8)


def _next(camera: Any) -> Shot:
    shot = camera.read()
    assert shot is not None
    return shot
