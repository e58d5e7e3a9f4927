# SPDX-License-Identifier: Apache-2.0
"""Pictures of phones and cameras, named by their content whatever they are called."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.capture.importers import import_captures, import_folders
from taccel_lab.errors import InputError
from taccel_lab.files.images import image_size, read_grey, read_image


def brands(*names: str) -> bytes:
    box = names[0].encode() + bytes(4) + b"".join(name.encode() for name in names[1:])
    return struct.pack(">I", 8 + len(box)) + b"ftyp" + box + bytes(range(256)) * 4


def tiff(*tags: tuple[int, int]) -> bytes:
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(400)


PICTURES = {
    "HEIC": [
        brands("heic", "mif1", "heic"),
        brands("heix"),
        brands("hevc"),
        brands("mif1", "heic"),
        brands("msf1"),
    ],
    "AVIF": [brands("avif", "mif1", "miaf"), brands("avis")],
    "JPEG XL": [b"\xff\x0a" + bytes(99), b"\0\0\0\x0cJXL \r\n\x87\n" + bytes(99)],
    "camera RAW": [
        brands("crx "),
        tiff((254, 1), (256, 160), (257, 120)),
        tiff((256, 4000), (50706, 0x00000601)),
        b"II*\0\x10\0\0\0CR\x02\0" + bytes(99),
        b"FUJIFILMCCD-RAW 0201" + bytes(99),
    ],
}
VIDEOS = [brands("isom", "mp42"), brands("qt  "), b"RIFF\0\0\0\0AVI LIST", b"\x1a\x45\xdf\xa3"]


@pytest.mark.parametrize("name", ["IMG_0001.HEIC", "IMG_0001.jpg", "IMG_0001.png"])
def test_formats_of_phones_are_named_with_the_way_out(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    for kind, contents in PICTURES.items():
        for content in contents:
            path.write_bytes(content)
            for read in (read_image, read_grey, image_size):
                with pytest.raises(InputError, match=f"{name} is an image of the format {kind};"):
                    read(path)
            with pytest.raises(InputError, match="Save PNG, best with the sensor's own app"):
                read_image(path)
    for content in VIDEOS:
        path.write_bytes(content)
        with pytest.raises(InputError, match="is a video, no image; PNG, JPEG"):
            read_image(path)


def test_tiff_and_webp_of_cameras_are_read(tmp_path: Path) -> None:
    levels = np.arange(48 * 64 * 3, dtype=np.uint8).reshape(48, 64, 3)
    for suffix in (".tif", ".webp", ".bmp", ".png"):
        path = tmp_path / f"a{suffix}"
        path.write_bytes(cv2.imencode(suffix, levels)[1].tobytes())
        assert read_image(path).shape == levels.shape


def test_folders_of_them_say_so(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    for number in (1, 2):
        (photos / f"IMG_000{number}.HEIC").write_bytes(PICTURES["HEIC"][0])
    said = r"holds 2 of the format HEIC \(IMG_0001.HEIC\), which is not read. Save PNG"
    with pytest.raises(InputError, match=said):
        import_captures(photos, tmp_path / "out")
    with pytest.raises(InputError, match=said):
        import_captures(photos, tmp_path / "out", "plain")
    with pytest.raises(InputError, match=said):
        Recording.of(photos)
    with pytest.raises(InputError, match="is an image of the format HEIC"):
        Recording.of(photos / "IMG_0001.HEIC")
    (photos / "background.png").write_bytes(cv2.imencode(".png", np.full((48, 64), 99))[1])
    (written,) = import_folders(photos, tmp_path / "out")
    (left_out,) = (note for note in written.notes if "left out" in note)
    assert "2 files (IMG_<n>.HEIC, 2 x): an image of the format HEIC, which is not" in left_out
    # Frames are not left out of a recording in silence.
    with pytest.raises(InputError, match=f"images that would be left out.*{said}"):
        Recording.of(photos)
