# SPDX-License-Identifier: Apache-2.0
"""Small files that state, or unpack to, far more than they hold, and the readers they meet."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from taccel_lab.cad.gel_import import part_faces
from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.datasets.arrays import Arrays
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.collada_file import read_collada
from taccel_lab.files.images import read_image
from taccel_lab.files.table_file import read_table
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.files.triangle_file import read_triangle_file
from taccel_lab.files.xml_file import read_xml
from taccel_lab.viewer.press_folder import read_press
from tests.files.bombs import arrays, recordings, shapes
from tests.files.bombs.written import Make

Read = Callable[[Path], object]


def _frames(path: Path, size: tuple[int, int] | None = None) -> None:
    for _ in Recording.of(path).frames(*([size] if size else [])):
        pass


_LEVELS = (1 << 17, 4096, 4096, 3)
_OF: dict[Read, dict[str, Make]] = {
    _frames: {
        "hdf5-unwritten": recordings.hdf5(_LEVELS, "u1", chunks=(1, 512, 512, 3), fillvalue=7),
        "hdf5-contiguous": recordings.hdf5(_LEVELS, "u1"),
        "hdf5-vlen": recordings.hdf5((1 << 40,), "vlen", chunks=(1024,)),
        "hdf5-fixed": recordings.hdf5((1 << 17,), "S1000", chunks=(1024,)),
        "hdf5-twice": recordings.hdf5_packed((1, 4096, 4096, 3), 400),
        "hdf5-long-chunks": recordings.hdf5_packed((1 << 17, 32, 32, 3), 1),
        "hdf5-shared": recordings.hdf5_shared,
        "lerobot-lengths": recordings.lerobot_lengths,
        "lerobot-times": recordings.lerobot_times,
        "mp4-samples": recordings.mp4_samples,
    },
    lambda path: _frames(path, (32, 24)): {"lerobot-rows": recordings.lerobot_rows},
    read_triangle_file: {
        "stl-count": shapes.STL,
        "ply-count": shapes.ply(4_000_000_000),
        "ply-late-count": shapes.ply(4_000_000_000, "comment x\n" * 7000),
        "ply-list": shapes.PLY_LIST,
        "obj-index": shapes.OBJ,
        "obj-polygon": shapes.polygon(60_000),
        "3mf-points": shapes.package_of_points,
        "3mf-lies": shapes.package_that_lies,
        "3mf-copies": shapes.package_of_copies,
    },
    read_collada: {"dae-copies": shapes.COLLADA_OF_COPIES},
    part_faces: {
        "step-copies": shapes.step_of_copies(1, 10_000),
        "step-levels": shapes.step_of_copies(25, 2),
    },
    read_tet_file: {
        "msh-nodes": shapes.MSH,
        "vtk-points": shapes.VTK_POINTS,
        "vtk-cells": shapes.VTK_CELLS,
        "vtk-structured": shapes.VTK_STRUCTURED,
        "vtu-points": shapes.VTU_POINTS,
        "vtu-cells": shapes.VTU_CELLS,
        "vtu-blocks": shapes.VTU_BLOCKS,
    },
    read_press: {"press-folder": shapes.press_folder},
    read_npz: {"npz-zeros": arrays.packed_zeros},
    read_image: {
        "png-size": arrays.png(8000, 8000, 10),
        "jpeg-size": arrays.jpeg(8000, 8000),
        "tiff-entries": arrays.tiff,
    },
    lambda path: list(read_table(path).rows()): {
        "table-lines": arrays.repeated("a.csv", "a\n", "1\n", 10_000_000)
    },
    lambda path: read_xml(path, "a URDF file"): {
        "xml-elements": arrays.repeated("a.xml", "<robot>", "<a/>", 4_000_000, "</robot>")
    },
    lambda path: Arrays(path)["rgb"][:]: {"zarr-shape": arrays.zarr_shape},
}
BOMBS = {name: (make, read) for read, makes in _OF.items() for name, make in makes.items()}
"""How each is written, by its name, and the reader that meets it."""
