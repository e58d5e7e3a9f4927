# SPDX-License-Identifier: Apache-2.0
"""Images and videos of others are read whole or refused; images that are kept."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib
from collections import Counter
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from taccel_lab.errors import InputError
from taccel_lab.files import apart, images
from taccel_lab.files.images import KeptImages, image_size, levels, read_grey, read_image
from taccel_lab.files.videos import count_frames, read_frames

RGB = np.random.default_rng(3).integers(0, 256, (12, 16, 3), dtype=np.uint8)
SUFFIXES = (".png", ".jpg", ".bmp", ".tiff", ".webp")


def encoded(suffix: str) -> bytes:
    return cv2.imencode(suffix, RGB[..., ::-1])[1].tobytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_allowed_formats_give_opencvs_pixels(suffix: str, tmp_path: Path) -> None:
    data, path = encoded(suffix), tmp_path / "a"
    path.write_bytes(data)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    image = read_image(path)
    np.testing.assert_array_equal(image, expected)
    assert image.flags.writeable and image.flags.c_contiguous
    np.testing.assert_array_equal(levels(str(path)), expected)
    grey = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(read_grey(path), grey)
    assert image_size(path) == (16, 12)


def tagged_tiff(order: str, big: bool, turn: int, levels: np.ndarray) -> bytes:
    """An uncompressed grey TIFF whose orientation tag says ``turn``."""
    end, offset = ("<" if order == "II" else ">"), 16
    (rows, columns), bits, start = levels.shape, 8 * levels.itemsize, offset + levels.nbytes
    tags = {
        256: columns, 257: rows, 258: bits, 259: 1, 262: 1, 273: offset, 274: turn, 277: 1,
        278: rows, 279: levels.nbytes,
    }  # fmt: skip
    head = struct.pack(f"{end}HHHQ", 43, 8, 0, start) if big else struct.pack(f"{end}HI", 42, start)
    data = (order.encode() + head).ljust(offset, b"\0") + levels.tobytes()
    data += struct.pack(f"{end}{'Q' if big else 'H'}", len(tags))
    for tag, value in tags.items():
        data += struct.pack(f"{end}HH{'QHxxxxxx' if big else 'IHxx'}", tag, 3, 1, value)
    return data + bytes(8)


@pytest.mark.parametrize("turn", range(1, 9))
def test_pixels_are_as_stored_whatever_a_tag_says(turn: int, tmp_path: Path) -> None:
    for suffix in (".png", ".jpg", ".webp"):
        for name, tag in (("turned", turn), ("as_stored", 1)):
            exif = Image.Exif()
            exif[0x0112] = tag
            Image.fromarray(RGB).save(tmp_path / f"{name}{suffix}", exif=exif)
        for read in (read_image, read_grey, image_size):
            expected = read(tmp_path / f"as_stored{suffix}")
            np.testing.assert_array_equal(read(tmp_path / f"turned{suffix}"), expected)
    path = tmp_path / "a.tiff"
    for order, big, kind in product(("II", "MM"), (False, True), ("u1", "u2")):
        grey = RGB[..., 0].astype(kind) * (1 if kind == "u1" else 257)
        stored = grey.astype({"II": "<", "MM": ">"}[order] + kind)
        path.write_bytes(tagged_tiff(order, big, turn, stored))
        np.testing.assert_array_equal(read_image(path), np.dstack([RGB[..., 0]] * 3))
        np.testing.assert_array_equal(read_grey(path), RGB[..., 0])
        assert image_size(path) == (16, 12)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_files_are_sentences(suffix: str, tmp_path: Path) -> None:
    data, path = encoded(suffix), tmp_path / "a"
    for share in (0.3, 0.9):
        path.write_bytes(data[: int(share * len(data))])
        for read in (read_image, read_grey, image_size):
            with pytest.raises(InputError, match="damaged or cut short; PNG, JPEG") as caught:
                read(path)
            assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(("width", "height"), [(50_000, 50_000), (8193, 8192)])
def test_the_size_in_the_header_is_limited(width: int, height: int, tmp_path: Path) -> None:
    path, body = (
        tmp_path / "large.png",
        b"IHDR" + struct.pack(">II5B", width, height, 8, 2, 0, 0, 0),
    )
    data = encoded(".png")
    path.write_bytes(data[:12] + body + struct.pack(">I", zlib.crc32(body)) + data[33:])
    for read in (read_image, read_grey, image_size):
        with pytest.raises(InputError, match=f"{width} x {height} px .* 67 megapixels are allowed"):
            read(path)


@pytest.mark.thorough
def test_large_images_are_read(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    rgb = np.zeros((4000, 6000, 3), dtype=np.uint8)
    rgb[-1, -1] = 1, 2, 3
    path.write_bytes(cv2.imencode(".png", rgb[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])
    np.testing.assert_array_equal(read_image(path), rgb)


def test_other_formats_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    for kind in ("GIF", "PPM", "ICO", "TGA"):
        content = io.BytesIO()
        Image.fromarray(RGB).save(content, kind)
        path.write_bytes(content.getvalue())
        with pytest.raises(InputError, match=f"the format {kind}; PNG, JPEG, BMP, TIFF or WebP"):
            read_image(path)
    for content in (b"x", b"%PDF-1.7 ...", b"BM", b"RIFF", b"\x89PNG", bytes(1000)):
        path.write_bytes(content)
        with pytest.raises(InputError, match="is not an image that can be read"):
            read_image(path)


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_an_image_of_which_no_pixel_shows_is_refused(mode: str, tmp_path: Path) -> None:
    path, image = tmp_path / "a.png", Image.fromarray(RGB).convert(mode)
    image.save(path)
    shown = read_image(path)
    image.putalpha(0)
    image.save(path)
    with pytest.raises(InputError, match="fully transparent"):
        read_image(path)
    image.putalpha(Image.fromarray(np.eye(*RGB.shape[:2], dtype=np.uint8)))
    image.save(path)
    np.testing.assert_array_equal(read_image(path), shown)


def test_images_are_decoded_once_while_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: Counter[str] = Counter()
    real = images.read_image

    def counted(path: Path) -> np.ndarray:
        decoded[path.name] += 1
        return real(path)

    monkeypatch.setattr(images, "read_image", counted)
    paths = [tmp_path / f"{i}.png" for i in range(3)]
    for i, path in enumerate(paths):
        cv2.imwrite(str(path), np.full((10, 20, 3), 40 * i, np.uint8))
    kept = KeptImages(limit_bytes=2 * 10 * 20 * 3)
    for _ in range(4):
        found = [kept.read(path) for path in paths]
    assert [int(image.mean()) for image in found] == [0, 40, 80]
    assert decoded == {"0.png": 1, "1.png": 1, "2.png": 4}
    with pytest.raises(ValueError, match="read-only"):
        found[0][:] = 1


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


@pytest.mark.parametrize("read", READERS)
def test_without_the_extra_a_video_asks_for_it(
    read: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "v.avi", "MJPG", 3)
    (tmp_path / "av.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(apart, "_readers", apart._Readers())
    with pytest.raises(InputError, match=r"v\.avi is decoded by PyAV, .*'taccel-lab\[video\]', or"):
        read(path)
    apart._readers.end()


def test_a_damaged_frame_is_left_out_and_an_end_cut_off_is_counted(tmp_path: Path) -> None:
    path = write(tmp_path / "v.avi", "MJPG", 20)
    whole, data = list(read_frames(path)), bytearray(path.read_bytes())
    at = [place for place in range(len(data)) if data[place : place + 3] == b"\xff\xd8\xff"]
    assert len(at) == 20
    data[at[5] : at[6] - 8] = bytes(at[6] - 8 - at[5])
    path.write_bytes(data)
    for frame, wanted in zip(read_frames(path), whole[:5] + whole[6:], strict=True):
        np.testing.assert_array_equal(frame, wanted)
    assert count_frames(path) == (19, 20)
    path.write_bytes(data[: at[12]])
    assert count_frames(path) == (11, 20) and len(list(read_frames(path))) == 11


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_only_one_frame_is_held(tmp_path: Path) -> None:
    path = write(tmp_path / "v.avi", "MJPG", 60, (640, 480))
    next(read_frames(path))
    tracemalloc.start()
    for _ in read_frames(path):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * 640 * 480 * 3


@pytest.mark.thorough
@pytest.mark.parametrize("read", READERS)
def test_frames_that_are_too_large_are_refused(read: Callable[[Path], Any], tmp_path: Path) -> None:
    path = write(tmp_path / "v.avi", "MJPG", 2, (8000, 4200))
    with pytest.raises(InputError, match="frames of 8000 x 4200 px; 34 megapixels are allowed"):
        read(path)


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "one.avi", "MJPG", 1)
    write(tmp_path / "v.mp4", "mp4v", 3)
    cv2.imwrite(str(tmp_path / "image.png"), np.zeros((48, 64, 3), np.uint8))
    for name, text in (
        ("text.avi", "none"),
        ("empty.avi", ""),
        # Lists of other files: what a file names is read nowhere else either.
        ("concat.mp4", "ffconcat version 1.0\nfile v.mp4\nfile v.mp4\n"),
        ("list.mp4", "#EXTM3U\n#EXTINF:10,\nv.mp4\n#EXT-X-ENDLIST\n"),
    ):
        (tmp_path / name).write_text(text)
    for path in set(tmp_path.iterdir()) - {tmp_path / "v.mp4"}:
        frames = int(path.name == "one.avi")
        for read in READERS:
            words = rf"does not decode as a video \({frames} frames read\); AVI, MP4"
            with pytest.raises(InputError, match=words):
                read(path)
