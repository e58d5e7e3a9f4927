# SPDX-License-Identifier: Apache-2.0
"""Times of frames are those that the recording carries, or those of a rate that is stated."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture.camera.recording import Recording, name_stamps
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_replay
from taccel_lab.calibration.capture.load import LOST_SHARE
from taccel_lab.errors import InputError
from taccel_lab.files.videos import RecordedFrame, count_frames, read_timed_frames

PAUSED_S = [0.0, 0.033, 0.066, 2.066, 2.1]
"""Frames at 30 Hz with a pause of 2 s."""


def vfr_video(path: Path, times_s: Sequence[float], codec: str = "mpeg4") -> Path:
    """Frames of increasing levels at these times, each a whole number of milliseconds."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, time_s in enumerate(times_s):
            levels = np.full((48, 64, 3), 20 + 20 * (number % 5), np.uint8)
            frame = av.VideoFrame.from_ndarray(levels, "rgb24")
            frame.pts, frame.time_base = round(1000 * time_s), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def times_of(source: Path, fps: float | None = None) -> list[float | None]:
    return [frame.time_s for frame in Recording.of(source, fps=fps).frames()]


@pytest.mark.parametrize(
    ("name", "codec"), [("v.mp4", "mpeg4"), ("v.mkv", "mpeg4"), ("v.mov", "libx264")]
)
def test_a_video_of_variable_rate_keeps_its_pause(name: str, codec: str, tmp_path: Path) -> None:
    # It begins a second late, as recorders write it that cut a stream.
    path = vfr_video(tmp_path / name, [1 + time_s for time_s in PAUSED_S], codec)
    assert [time_s for time_s, _ in read_timed_frames(path)] == pytest.approx(
        [1 + time_s for time_s in PAUSED_S], abs=1e-3
    )
    recording = Recording.of(path)
    frames = list(recording.frames())
    assert [frame.time_s for frame in frames] == pytest.approx(PAUSED_S, abs=1e-3)
    levels = [float(np.mean(np.asarray(frame.image))) for frame in frames]
    assert levels == pytest.approx([20, 40, 60, 80, 100], abs=4)
    assert recording.times_from == "the video's own times"
    assert times_of(path, fps=10.0) == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_a_container_without_a_count_states_what_fills_its_duration(tmp_path: Path) -> None:
    """WebM and MKV count no frames; a pause makes none of them miss, an end cut off does."""
    times_s = [*np.arange(0, 1, 0.04), *np.arange(9, 12, 0.04)]
    path = vfr_video(tmp_path / "v.mkv", times_s)
    count, stated = count_frames(path)
    assert count == 100 and stated == pytest.approx(100, abs=2)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    count, stated = count_frames(path)
    assert 0 < count < LOST_SHARE * stated


@pytest.mark.parametrize(
    "names",
    [
        ["1699999999033000000", "1699999999066000000", "1700000001066000000"],
        ["1699999999.033", "1699999999.066", "1700000001.066"],
        ["left_1699999999-033000000", "left_1699999999-066000000", "left_1700000001-066000000"],
        ["1699999999033_rgb", "1699999999066_rgb", "1700000001066_rgb"],
        ["1699999999033000", "1699999999066000", "1700000001066000"],
    ],
)
def test_stamps_in_names_are_times(names: list[str]) -> None:
    assert name_stamps(names) == pytest.approx([0.0, 0.033, 2.033], abs=1e-12)


@pytest.mark.parametrize(
    "names",
    [
        ["frame_0", "frame_1"],
        ["0000000001", "0000000002"],  # Counters.
        ["20231114_101112", "20231114_101113"],  # Dates.
        ["1699999999033000000", "background"],
        ["left_1699999999", "right_1700000000"],  # Two cameras.
        ["1699999999.5", "1699999999.50"],  # Twice the same.
        ["1699999999_1700000000", "1699999999_1700000001"],  # Which of them?
        ["12033000000", "12066000000"],  # Of a simulation's clock, or numbers.
        ["16999999990330000001", "16999999990660000001"],  # A digit more than nanoseconds have.
        [],
    ],
)
def test_other_names_are_no_times(names: list[str]) -> None:
    assert name_stamps(names) is None


def test_images_are_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    """Programs that drop zeros behind the point write .5 for what comes after .033."""
    for number, name in enumerate(["1699999999.033", "1699999999.5", "1700000001.5"]):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((8, 8, 3), 50 * number, np.uint8))
    recording = Recording.of(tmp_path)
    frames = list(recording.frames())
    assert [int(np.asarray(frame.image)[0, 0, 0]) for frame in frames] == [0, 50, 100]
    assert [frame.time_s for frame in frames] == [0.0, 0.467, 2.467]
    assert recording.times_from == "the stamps in the names"
    assert times_of(tmp_path, fps=2.0) == [0.0, 0.5, 1.0]


def test_a_clock_that_stands_or_goes_back_tells_nothing_until_it_is_ahead_again() -> None:
    clock = [5.0, 5.1, 5.1, 4.0, 5.2, float("nan"), None, 5.3]
    again = [0.0, 0.1]
    frames = [RecordedFrame("", InputError("torn"), time_s, 7) for time_s in clock]
    frames += [RecordedFrame("", InputError("torn"), time_s, 3) for time_s in again]
    found = list(Recording(Path(), "", lambda: 10, lambda: iter(frames)).frames())
    assert [frame.time_s for frame in found] == [0, 0.1, None, None, 0.2, None, None, 0.3, 0, 0.1]
    assert [frame.episode for frame in found] == [0] * 8 + [1] * 2
    rated = Recording(Path(), "", lambda: 10, lambda: iter(frames), fps=10.0)
    assert [frame.time_s for frame in rated.frames()][-3:] == [0.7, 0.0, 0.1]
    assert rated.times_from == "--fps 10"


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf"), 1e300, 1e-300])
def test_a_rate_that_is_none_is_refused(fps: float, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--fps must lie in"):
        Recording.of(tmp_path, fps=fps)


def test_a_replay_keeps_the_pause(tmp_path: Path) -> None:
    camera = open_replay(vfr_video(tmp_path / "v.mp4", PAUSED_S))
    shots = [camera.read() for _ in PAUSED_S]
    times = [shot.time_s for shot in shots if shot is not None]
    assert times == pytest.approx(PAUSED_S, abs=1e-3) and camera.read() is None
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((8, 8, 3), np.uint8))
    camera = open_replay(tmp_path, CameraReplay(fps=10.0))
    shots = [camera.read() for _ in range(3)]
    assert [shot.time_s for shot in shots if shot is not None] == pytest.approx([0, 0.1, 0.2])
