# SPDX-License-Identifier: Apache-2.0
"""Cameras are found by what stays with them, opened, locked as far as they hold it; replays."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture.camera import camera as cameras
from taccel_lab.calibration.capture.camera import uvc
from taccel_lab.calibration.capture.camera.camera import CameraLostError, ControlValues, Framing
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera
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


def test_cameras_are_listed_and_found_by_any_of_their_names(machine: Path) -> None:
    found = {device.id: device for device in uvc.list_devices(machine)}
    assert set(found) == {MINI, DIGIT} and found[MINI].name == "GelSight"
    assert found[DIGIT].node == "/dev/video0" and found[DIGIT].serial == "D20025"
    for wanted in (DIGIT, "D20025", "digit", "/dev/video0", "d2002"):
        assert uvc.find_device(wanted, machine).id == DIGIT
    for wanted, folder, words in (
        ("usb", machine, f"several.*{DIGIT}"),
        ("D99999", machine, f"no camera matches.*{MINI}"),
        ("D20025", machine / "empty", "no camera is plugged in"),
    ):
        with pytest.raises(InputError, match=words):
            uvc.find_device(wanted, folder)


class FakeCapture:
    """A ``cv2.VideoCapture`` that takes values as some drivers do."""

    def __init__(self, *, opens: bool = True, keeps_auto: bool = False, frames: int = 3) -> None:
        self.opens, self.keeps_auto, self.left = opens, keeps_auto, frames
        self.released, self.taken_s = False, 0.0
        self.values: dict[int, float] = {
            cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_EXPOSURE: 156.0,
            cv2.CAP_PROP_AUTO_WB: 1.0, cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
            cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
        }  # fmt: skip

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


DEVICE = uvc.Device(DIGIT, "/dev/video0", "DIGIT", "D20025")


def opened(capture: FakeCapture, size: tuple[int, int] | None = None) -> uvc.UvcCamera:
    return uvc.UvcCamera(DEVICE, size, open_capture=lambda _: capture)


def test_controls_are_locked_and_read_back() -> None:
    camera = opened(capture := FakeCapture())
    exposure, gain, balance = camera.lock(ControlValues())
    assert capture.values[cv2.CAP_PROP_AUTO_EXPOSURE] == uvc.MANUAL_EXPOSURE
    assert exposure.held and "156" in exposure.text
    assert gain.held is None and "no such control" in gain.text
    assert balance.held and "4600" in balance.text
    assert camera.lock(ControlValues(exposure=201.0))[0].held  # 200: a step of the driver's
    assert not camera.lock(ControlValues(exposure=1.0))[0].held
    balance = opened(FakeCapture(keeps_auto=True)).lock(ControlValues())[2]
    assert balance.held is False and "cannot be locked" in balance.text


def test_frames_are_rgb_with_the_drivers_time() -> None:
    camera = opened(capture := FakeCapture(frames=1))
    shot = camera.read()
    assert shot.time_s == pytest.approx(capture.taken_s, abs=1e-6)
    assert tuple(shot.image[0, 0]) == (30, 20, 10)
    with pytest.raises(CameraLostError, match="no frames"):
        camera.read()


def test_what_does_not_open_or_has_no_such_size_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CameraLostError, match="group video"):
        opened(FakeCapture(opens=False))
    monkeypatch.setattr(FakeCapture, "set", lambda *_: False)
    capture = FakeCapture()
    with pytest.raises(InputError, match="640x480"):
        opened(capture, (320, 240))
    assert capture.released


@pytest.mark.thorough
def test_files_are_replayed(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi")
    for folder in ("images", "none"):
        (tmp_path / folder).mkdir()
    for k in (2, 10, 1):
        write_image(tmp_path / "images" / f"f_{k}.png", np.full((40, 50, 3), k, np.uint8))
    camera = open_camera(str(tmp_path / "images"))
    found = [camera.read() for _ in range(4)]
    assert [shot and int(shot.image[0, 0, 0]) for shot in found] == [1, 2, 10, None]
    assert open_camera(str(tmp_path / "a.avi")).read() is not None
    with pytest.raises(InputError, match="no images"):
        open_camera(str(tmp_path / "none"))


def test_a_capture_folder_is_pressed_again(tmp_path: Path) -> None:
    folder = CaptureMaker(circles=spread_circles(2)).write(tmp_path / "set")
    replay = CameraReplay(fps=10, rest_s=1.0, hold_s=0.5, blend_s=0.2)
    camera = open_camera(str(folder), None, replay)
    frames = list(iter(camera.read, None))
    assert len(frames) == 10 + 2 * (5 + 2 * 1 + 5)
    assert frames[1].time_s - frames[0].time_s == pytest.approx(0.1)


def test_a_lost_camera_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taccel_lab.calibration.capture.camera.camera.AGAIN_S", 0.0)
    captures, seen = [FakeCapture(frames=2), FakeCapture(frames=2)], []

    def open_() -> uvc.UvcCamera:
        if not captures:
            raise CameraLostError("still gone")
        return opened(captures.pop())

    stream = cameras.shots(open_, lambda camera: seen.append(camera.info.id))
    kinds = [type(next(stream)).__name__ for _ in range(8)]
    stream.close()
    assert kinds == ["Shot", "Shot", "Gap", "Shot", "Shot", "Gap", "Gap", "Gap"] and len(seen) == 2


def test_framing_cuts_and_shrinks_and_refuses_what_does_not_fit() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    image[100:, 200:] = 200
    kept = Framing.parse("200,100,400x300", "200x150").apply(image)
    assert kept.shape == (150, 200, 3) and (kept == 200).all()
    for crop, size, words in (
        ("300,0,400x300", None, "reaches to"),
        (None, "100x100", "both sides alike"),
        ("1,2,3", None, "--crop is"),
    ):
        with pytest.raises(InputError, match=words):
            Framing.parse(crop, size).apply(image)
