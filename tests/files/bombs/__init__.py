# SPDX-License-Identifier: Apache-2.0
"""Small files that state, or unpack to, far more than they hold."""

from __future__ import annotations

from tests.files.bombs import arrays, readers, recordings, shapes, steps
from tests.files.bombs.readers import Make, Read

_LEVELS = (1 << 17, 4096, 4096, 3)
BOMBS: dict[str, tuple[Make, Read]] = {
    "hdf5-unwritten": (
        recordings.hdf5(_LEVELS, "u1", chunks=(1, 512, 512, 3), fillvalue=7),
        readers.frames,
    ),
    "hdf5-contiguous": (recordings.hdf5(_LEVELS, "u1"), readers.frames),
    "hdf5-vlen": (recordings.hdf5((1 << 40,), "vlen", chunks=(1024,)), readers.frames),
    "hdf5-fixed": (recordings.hdf5((1 << 17,), "S1000", chunks=(1024,)), readers.frames),
    "hdf5-twice": (recordings.hdf5_packed((1, 4096, 4096, 3), 400), readers.frames),
    "hdf5-long-chunks": (recordings.hdf5_packed((1 << 17, 32, 32, 3), 1), readers.frames),
    "hdf5-shared": (recordings.hdf5_shared, readers.frames),
    "lerobot-rows": (recordings.lerobot_rows, readers.sized_frames),
    "lerobot-lengths": (recordings.lerobot_lengths, readers.frames),
    "lerobot-times": (recordings.lerobot_times, readers.frames),
    "mp4-samples": (recordings.mp4_samples, readers.frames),
    "stl-count": (shapes.STL, readers.triangles),
    "ply-count": (shapes.ply(4_000_000_000), readers.triangles),
    "ply-late-count": (shapes.ply(4_000_000_000, "comment x\n" * 7000), readers.triangles),
    "ply-list": (shapes.PLY_LIST, readers.triangles),
    "obj-index": (shapes.OBJ, readers.triangles),
    "obj-polygon": (shapes.polygon(60_000), readers.triangles),
    "3mf-points": (shapes.package_of_points, readers.triangles),
    "3mf-lies": (shapes.package_that_lies, readers.triangles),
    "3mf-copies": (shapes.package_of_copies, readers.triangles),
    "dae-copies": (shapes.collada_of_copies, readers.collada),
    "step-copies": (steps.step_of_copies(1, 10_000), readers.step),
    "step-levels": (steps.step_of_copies(25, 2), readers.step),
    "msh-nodes": (shapes.MSH, readers.tets),
    "vtk-points": (shapes.VTK_POINTS, readers.tets),
    "vtk-cells": (shapes.VTK_CELLS, readers.tets),
    "vtk-structured": (shapes.VTK_STRUCTURED, readers.tets),
    "vtu-points": (shapes.VTU_POINTS, readers.tets),
    "vtu-cells": (shapes.VTU_CELLS, readers.tets),
    "vtu-blocks": (shapes.vtu_blocks, readers.tets),
    "press-folder": (shapes.press_folder, readers.press),
    "npz-zeros": (arrays.packed_zeros, readers.npz),
    "png-size": (arrays.png(8000, 8000, 10), readers.image),
    "jpeg-size": (arrays.jpeg(8000, 8000), readers.image),
    "tiff-entries": (arrays.tiff, readers.image),
    "table-lines": (arrays.repeated("a.csv", "a\n", "1\n", 10_000_000), readers.text("table")),
    "xml-elements": (
        arrays.repeated("a.xml", "<robot>", "<a/>", 4_000_000, "</robot>"),
        readers.text("xml"),
    ),
    "zarr-shape": (arrays.zarr_shape, readers.arrays),
}
"""How each is written, by its name, and the reader that meets it."""
