# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab live`` on files: each frame is read once, and as other commands read it."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera
from tests.calibration.depth.test_depth import grey_unit
from tests.cli.conftest import Cli
from tests.support.capture_sets import write_image

SHOTS = 12


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    """A profile with its own untouched image."""
    unit, folder = grey_unit(), tmp_path / "profile"
    tl.save_profile(replace(unit.profile, background_rgb=unit.rest), folder)
    return folder


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """Presses alone, and a file that is no image."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(SHOTS):
        write_image(folder / f"{number}.png", shifted(number))
    (folder / "3.png").write_bytes(b"no image")
    return folder


def shifted(number: int) -> np.ndarray:
    """The press, some pixels further on."""
    return np.roll(grey_unit().pressed, 2 * number - SHOTS, axis=1)


def video(path: Path) -> Path:
    """The presses as a video without loss, a hundred frames a second."""
    height, width = grey_unit().rest.shape[:2]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=100)
        stream.height, stream.width = height, width
        stream.pix_fmt, stream.codec_context.time_base = "bgr0", Fraction(1, 100)
        for number in range(SHOTS):
            frame = av.VideoFrame.from_ndarray(shifted(number), "rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 100)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.thorough
def test_each_photo_and_each_frame_is_read_as_by_other_calls(
    profile: Path, photos: Path, tmp_path: Path, cli: Cli
) -> None:
    last = tl.read(profile, shifted(SHOTS - 1)).figures()
    assert last["depth_mm"] > 1.0
    for source, count in ((photos, SHOTS - 1), (video(tmp_path / "v.mkv"), SHOTS)):
        done = cli("live", profile, "--camera", source, "--no-page", "--json")
        found = json.loads(done.out)
        assert found["latency"]["frames"] == count
        assert {name: found["last"][name] for name in last} == last
        assert ("3.png" in done.err) is (source == photos)
    stages = found["latency"]["stages_ms"]
    assert {"light", "touch", "heights", "pressure", "wait"} <= set(stages)


def test_photos_wait_for_no_time_and_a_video_for_its_own(photos: Path, tmp_path: Path) -> None:
    (photos / "3.png").unlink()

    def seconds(path: Path) -> float:
        start = time.monotonic()
        camera = open_camera(str(path), None, CameraReplay(fps=4.0, paced=True))
        while camera.read() is not None:
            pass
        return time.monotonic() - start

    assert seconds(photos) < 0.5 * (SHOTS - 2) / 4.0
    assert seconds(video(tmp_path / "v.mkv")) >= 0.9 * (SHOTS - 1) / 100
