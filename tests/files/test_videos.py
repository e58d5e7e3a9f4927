# SPDX-License-Identifier: Apache-2.0
"""Videos are read frame by frame, as OpenCV decodes them; what is none is a sentence."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.videos import count_frames, read_frames

READERS: list[Callable[[Path], Any]] = [count_frames, lambda p: list(read_frames(p))]


def write(path: Path, code: str, count: int, size: tuple[int, int] = (64, 48)) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 25.0, size)
    if not writer.isOpened():
        pytest.skip("OpenCV is built without a video writer")
    for level in range(count):
        frame = np.full((size[1], size[0], 3), 60 + level % 100, np.uint8)
        frame[:20, :10] = 0, 0, 200
        writer.write(frame)
    writer.release()
    return path


@pytest.mark.parametrize(("name", "code"), [("v.avi", "MJPG"), ("v.mp4", "mp4v")])
def test_frames_are_those_that_opencv_decodes(name: str, code: str, tmp_path: Path) -> None:
    path = write(tmp_path / name, code, 120)
    capture, count = cv2.VideoCapture(str(path)), 0
    for frame in read_frames(path):
        np.testing.assert_array_equal(frame, capture.read()[1][..., ::-1])
        count += 1
    assert count == 120 and not capture.read()[0]
    assert count_frames(path) == (120, 120)


@pytest.mark.parametrize("turn", [(0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0)])
def test_frames_are_as_stored_whatever_a_player_is_asked_to_turn(
    turn: tuple[int, ...], tmp_path: Path
) -> None:
    path = write(tmp_path / "v.mp4", "mp4v", 3)
    stored, data = next(read_frames(path)), bytearray(path.read_bytes())
    # The matrix of ISO/IEC 14496-12, 8.3.2: a, b, u; c, d, v; x, y, w in the track's header.
    at = data.index(b"tkhd") + 44
    a, b, c, d = (value << 16 for value in turn)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_ORIENTATION_META) != 0
    np.testing.assert_array_equal(next(read_frames(path)), stored)


def test_only_one_frame_is_held(tmp_path: Path) -> None:
    path = write(tmp_path / "v.avi", "MJPG", 60, (640, 480))
    next(read_frames(path))
    tracemalloc.start()
    for _ in read_frames(path):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * 640 * 480 * 3


@pytest.mark.parametrize("read", READERS)
def test_frames_that_are_too_large_are_refused(read: Callable[[Path], Any], tmp_path: Path) -> None:
    path = write(tmp_path / "v.avi", "MJPG", 2, (8000, 4200))
    with pytest.raises(InputError, match="frames of 8000 x 4200 px; 34 megapixels are allowed"):
        read(path)


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "one.avi", "MJPG", 1)
    write(tmp_path / "v.mp4", "mp4v", 3)
    cv2.imwrite(str(tmp_path / "image.png"), np.zeros((48, 64, 3), np.uint8))
    (tmp_path / "text.avi").write_text("none")
    (tmp_path / "empty.avi").touch()
    # Lists of other files: what a file names is read nowhere else either.
    (tmp_path / "concat.mp4").write_text("ffconcat version 1.0\nfile v.mp4\nfile v.mp4\n")
    (tmp_path / "list.mp4").write_text("#EXTM3U\n#EXTINF:10,\nv.mp4\n#EXT-X-ENDLIST\n")
    for name, words in (
        ("one.avi", r"does not decode as a video \(1 frames read\); AVI, MP4"),
        ("text.avi", r"\(0 frames read\)"),
        ("empty.avi", r"\(0 frames read\)"),
        ("image.png", r"\(0 frames read\)"),
        ("concat.mp4", r"\(0 frames read\)"),
        ("list.mp4", r"\(0 frames read\)"),
    ):
        for read in READERS:
            with pytest.raises(InputError, match=words):
                read(tmp_path / name)


@pytest.mark.parametrize(("name", "code"), [("v.avi", "MJPG"), ("v.mp4", "mp4v")])
def test_damaged_videos_are_sentences_or_shorter(name: str, code: str, tmp_path: Path) -> None:
    data = write(tmp_path / name, code, 20).read_bytes()
    path, random = tmp_path / f"damaged_{name}", Random(11)
    for k in range(25):
        damaged = bytearray(data[: random.randint(len(data) // 2, len(data))] if k % 2 else data)
        for _ in range(4):
            damaged[random.randrange(len(damaged))] = random.randrange(256)
        path.write_bytes(damaged)
        try:
            counted, _ = count_frames(path)
            assert 2 <= counted <= 25
            assert sum(1 for _ in read_frames(path)) <= 25
        except InputError as error:
            assert str(path) in str(error)
