# SPDX-License-Identifier: Apache-2.0
"""How users' files are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

Make = Callable[[Path], Path]
"""Writes a file into a folder."""
Read = Callable[[Path], object]


def frames(path: Path) -> object:
    """Read all frames of a recording."""
    from taccel_lab.calibration.capture.camera.recording import Recording

    last = None
    for frame in Recording.of(path).frames():
        last = frame.image
    return last


def sized_frames(path: Path) -> object:
    """Read frames of a camera of 32 x 24 px."""
    from taccel_lab.calibration.capture.camera.recording import Recording

    return list(Recording.of(path).frames((32, 24)))


def triangles(path: Path) -> object:
    from taccel_lab.files.triangle_file import read_triangle_file

    return read_triangle_file(path)


def tets(path: Path) -> object:
    from taccel_lab.files.tet_file import read_tet_file

    return read_tet_file(path)


def collada(path: Path) -> object:
    from taccel_lab.files.collada_file import read_collada

    return read_collada(path)


def step(path: Path) -> object:
    from taccel_lab.cad.gel_import import part_faces

    return part_faces(path)


def image(path: Path) -> object:
    from taccel_lab.files.images import read_image

    return read_image(path)


def npz(path: Path) -> object:
    from taccel_lab.files.arrays import read_npz

    return read_npz(path)


def text(kind: str) -> Read:
    """Reader of a kind of text file."""

    def read(path: Path) -> object:
        from taccel_lab.files.documents import read_toml
        from taccel_lab.files.table_file import read_table
        from taccel_lab.files.xml_file import read_xml

        if kind == "table":
            return list(read_table(path).rows())
        return read_toml(path) if kind == "toml" else read_xml(path, "a URDF file")

    return read


def press(path: Path) -> object:
    from taccel_lab.viewer.press_folder import read_press

    return read_press(path)


def arrays(path: Path) -> object:
    from taccel_lab.datasets.arrays import Arrays

    return Arrays(path)["rgb"][:]
