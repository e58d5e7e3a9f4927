# SPDX-License-Identifier: Apache-2.0
"""A camera that shows no gel, hangs or flickers is told, and no background is made of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.capture.camera import Replay, Shot, open_camera
from taccel_lab.calibration.capture.camera.camera import CameraInfo
from taccel_lab.calibration.record.camera_faults import FROZEN_S
from taccel_lab.calibration.record.folder import open_record
from taccel_lab.calibration.record.run import run_session
from taccel_lab.calibration.record.session import Recorder, Status
from taccel_lab.errors import InputError
from tests.calibration.record.sessions import FACTS, Watching
from tests.support.capture_sets import gel, write_image

FRAMES = 50


def shown(folder: Path, frames: list[np.ndarray], out: Path) -> list[Status]:
    """What a session says of a folder of frames."""
    folder.mkdir()
    for k, frame in enumerate(frames):
        write_image(folder / f"{k:03d}.png", frame)
    watching = Watching()
    with open_record(out, FACTS) as record:
        recorder = Recorder(record, FACTS, 1)
        run_session(recorder, lambda: open_camera(str(folder), None, Replay()), [watching])
    return watching.seen


def noisy(count: int = FRAMES, gains: tuple[float, ...] = (1.0,)) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [
        np.clip(gel() * gains[k % len(gains)] + rng.normal(0, 1, gel().shape), 0, 255)
        .round()
        .astype(np.uint8)
        for k in range(count)
    ]


@pytest.mark.parametrize(("level", "said"), [(0, "black"), (255, "white")])
def test_the_untouched_gel_waits_until_one_is_seen(tmp_path: Path, level: int, said: str) -> None:
    blank = [np.full(gel().shape, level, np.uint8)] * FRAMES
    seen = shown(tmp_path / "blank", blank, tmp_path / "none")
    assert said in seen[-1].prompt and said in seen[-1].unseen
    assert not (tmp_path / "none").exists()
    seen = shown(tmp_path / "later", [*blank, *noisy()], tmp_path / "out")
    assert seen[-1].prompt.startswith("Press next") and seen[-1].unseen == ""
    background = load_capture_folder(tmp_path / "out").background
    assert background is not None
    assert np.abs(background.image().astype(float) - gel()).mean() < 2.0


def test_light_that_flickers_lights_its_lamp(tmp_path: Path) -> None:
    def state(name: str, gains: tuple[float, ...]) -> tuple[str, str]:
        seen = shown(tmp_path / name, noisy(gains=gains), tmp_path / f"out_{name}")
        lamp = next(lamp for lamp in seen[-1].lamps if lamp.name == "flicker")
        return lamp.state, lamp.told

    assert state("steady", (1.0,))[0] == "ok"
    flickers, told = state("flickers", (0.9, 1.1))
    assert flickers == "bad" and "10 ms" in told


@pytest.mark.parametrize("replayed", [False, True])
def test_a_camera_that_hangs_is_told_a_replay_is_not(tmp_path: Path, replayed: bool) -> None:
    with open_record(tmp_path / "out", FACTS) as folder:
        recorder = Recorder(folder, FACTS, 1)
        recorder.opened(CameraInfo("usb-1", "mine", replayed=replayed), [])
        for k, image in enumerate(noisy()):
            status = recorder.see(Shot(image, k / 25))
        start = FRAMES / 25
        for k in range(int(25 * (FROZEN_S + 1))):
            status = recorder.see(Shot(image, start + k / 25))
        lamp = next(lamp for lamp in status.lamps if lamp.name == "camera")
        assert ("hangs" in status.prompt) is not replayed
        assert ("hangs" in lamp.told and lamp.state == "bad") is not replayed
        status = recorder.see(Shot(noisy(1)[0], start + FROZEN_S + 1.1))
        assert "hangs" not in status.prompt


def test_images_too_small_to_calibrate_leave_nothing(tmp_path: Path) -> None:
    small = [np.full((12, 16, 3), 90, np.uint8)] * 5
    with pytest.raises(InputError, match="16x12 px; at least 32x32"):
        shown(tmp_path / "small", small, tmp_path / "out")
    assert not (tmp_path / "out").exists()
