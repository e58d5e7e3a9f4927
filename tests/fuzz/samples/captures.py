# SPDX-License-Identifier: Apache-2.0
"""Capture folders of tiny images, with all that a manifest can name."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.geometry import PixelGrid

WIDTH, HEIGHT = 40, 34
_HEAD = (
    'schema_version = 2\nsensor = "flat_pad"\nunit = "S1"\nbackground = "background.png"\n'
    'untouched = ["untouched.jpg"]\nmask = "mask.png"\nmm_per_px_x = 0.1\nmm_per_px_y = 0.1\n'
    'source = "made up"\nlicense = "CC0"\n'
)
_PRESSES = (
    '\n[indenter]\nkind = "sphere"\nradius_mm = 2.0\n\n'
    '[[presses]]\nimage = "p0.png"\nname = "corner"\n'
    "contact = { u_px = 18.0, v_px = 16.0, radius_px = 8.0 }\ndepth_mm = 0.4\nforce_n = 0.7\n\n"
    '[[presses]]\nimage = "p1.jpg"\nradius_mm = 3.0\n\n'
    '[[presses]]\nimage = "p2.png"\n'
)
_TARGETS = (
    '\n[split]\nheldout = ["p2"]\n\n'
    '[[boards]]\nkind = "charuco"\ncolumns = 6\nrows = 5\npitch_mm = 2.5\nmarker_mm = 1.8\n'
    'dictionary = "DICT_4X4_50"\non_gel = true\nimages = ["board.png"]\n'
    'reference = "background.png"\n\n'
    '[[edges]]\nimage = "p0.png"\nlength_mm = 2.0\ndihedral_deg = 90.0\n'
    "line = { u_px = 16.0, v_px = 12.0, length_px = 15.0, angle_deg = 4.0 }\n"
)
_MARKERS = (
    '\n[markers]\nrest = "background.png"\npitch_x_mm = 2.0\npitch_y_mm = 2.0\n'
    'labels = "dots.csv"\n\n'
    '[[markers.videos]]\nfile = "shear.avi"\nfps = 25.0\nmotion = "shear"\n\n'
    '[[markers.videos]]\nframes = ["p?.png"]\nmotion = "free"\n'
)
_TABLES = {
    "indentation": "depth_mm,force_n,sigma_n\n0.2,0.05,0.01\n0.4,0.15,0.01\n0.8,0.4,0.01\n",
}
_RECORD = (
    '\n[[records]]\nfile = "{0}.csv"\nkind = "{0}"\n'
    'tool = {{ kind = "sphere", radius_mm = 4.0, center_mm = [0.0, 0.0] }}\n'
    "force_sigma_n = 0.02\n"
)
_DOTS = "u_px,v_px,du_px,dv_px\n5,6,0.1,0.2\n15,6,0.1,0.3\n"


def picture(number: int) -> np.ndarray:
    """A smooth picture with a dent, RGB."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    gel = np.stack([90 + u, 120 - v, 100 + 0.3 * u * v / 10], axis=-1)
    r2 = (u - 18 - number) ** 2 + (v - 16) ** 2
    dent = 40 * np.exp(-r2 / 40)[..., None] * np.array([1.0, -0.6, 0.5]) * (number > 0)
    return np.clip(gel + dent, 0, 255).astype(np.uint8)


def write_image(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


def write_video(path: Path) -> None:
    """Three frames of Motion JPEG."""
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (WIDTH, HEIGHT), True
    )
    for number in range(3):
        writer.write(np.ascontiguousarray(picture(number)[..., ::-1]))
    writer.release()


def presses(given: Path) -> None:
    """Background, mask, presses and what a person says of them."""
    _images(given)
    (given / "captures.toml").write_text(_HEAD + _PRESSES)
    (given / "contacts.toml").write_text(
        '[[contact]]\npress = "corner"\nu_px = 18.5\nv_px = 16.0\nradius_px = 8.0\n\n'
        '[[contact]]\npress = "p1"\nskip = true\n'
    )


def whole(given: Path) -> None:
    """All that a manifest can hold."""
    presses(given)
    records(given)
    write_video(given / "shear.avi")
    (given / "dots.csv").write_text(_DOTS)
    text = _HEAD + _PRESSES + _TARGETS + _MARKERS + "".join(map(_RECORD.format, _TABLES))
    (given / "captures.toml").write_text(text)


def records(given: Path) -> None:
    """Force records of each kind."""
    for kind, table in _TABLES.items():
        (given / f"{kind}.csv").write_text(table)
    text = 'schema_version = 2\nsensor = "flat_pad"\n' + "".join(map(_RECORD.format, _TABLES))
    (given / "captures.toml").write_text(text)


def videos(given: Path) -> None:
    """Dots that move: a video file, and labels."""
    write_image(given / "background.png", picture(0))
    write_video(given / "shear.avi")
    (given / "dots.csv").write_text(_DOTS)
    markers = _MARKERS.split("\n[[markers.videos]]\nframes")[0]
    (given / "captures.toml").write_text(
        'schema_version = 2\nsensor = "flat_pad"\nbackground = "background.png"\n' + markers
    )


def raw_with_maps(given: Path) -> None:
    """Captures ``raw`` and maps that rectify them."""
    raw = given / "raw"
    raw.mkdir()
    whole(raw)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    maps = RectificationMaps(u, v, np.ones(u.shape, bool), PixelGrid(WIDTH, HEIGHT, 0.1, 0.1))
    maps.save(given / "maps.npz")


def _images(given: Path) -> None:
    for name, number in (("background.png", 0), ("untouched.jpg", 0), ("p0.png", 1), ("p1.jpg", 2),
                         ("p2.png", 3), ("board.png", 0)):  # fmt: skip
        write_image(given / name, picture(number))
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:4] = 0
    write_image(given / "mask.png", mask)


def texture(given: Path) -> None:
    """A grey height map."""
    u = np.linspace(0, 4 * np.pi, WIDTH)
    heights = 127 + 120 * np.sin(u)[None] * np.cos(u[:HEIGHT])[:, None]
    write_image(given / "coin.png", heights.astype(np.uint8))


def frames(given: Path) -> None:
    """Images of a folder that is replayed as a camera."""
    (given / "frames").mkdir()
    rng = np.random.default_rng(3)
    for number in range(4):
        image = rng.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        write_image(given / "frames" / f"frame_{number}.png", image)
