# SPDX-License-Identifier: Apache-2.0
"""Meshes of published examples: where they are, and binary STL files read with numpy alone.

They lie in ``taccel_assets`` below the data folder, which is ``TACCEL_LAB_DATA``, or
``../shared/data`` beside a checkout; nothing in it is needed, since every scene can make meshes of
the same dimensions itself.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError, naming
from taccel_lab.files.regular_file import read_regular_file
from taccel_lab.scene import TriangleMesh

_MAX_BYTES = 100 << 20
"""Two million triangles."""


def data_folder() -> Path:
    """Where published meshes and real captures are looked for."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("TACCEL_LAB_DATA", beside))


def mesh_folder() -> Path:
    """Where the published meshes are looked for."""
    return data_folder() / "taccel_assets"


def has_data(*parts: str) -> bool:
    """Whether these files or folders of ``mesh_folder`` are there."""
    return all((mesh_folder() / part).exists() for part in parts)


def choose_source(source: str, *parts: str) -> str:
    """ "published" or "generated": what was asked for, or, for "auto", what there is."""
    if source not in ("auto", "published", "generated"):
        raise InputError(f"source must be auto, published or generated, got {source!r}")
    there = has_data(*parts)
    if source == "published" and not there:
        missing = [part for part in parts if not has_data(part)]
        raise InputError(
            f"the published meshes are not at {mesh_folder()} ({', '.join(missing)}); set "
            "TACCEL_LAB_DATA, or take source generated"
        )
    return "published" if there and source != "generated" else "generated"


def read_stl(path: Path) -> TriangleMesh:
    """A binary STL file in metres, vertices of the same coordinates merged."""
    data = read_regular_file(path, _MAX_BYTES, "a binary STL file")
    count = int(np.frombuffer(data, "<u4", 1, 80)[0]) if len(data) >= 84 else -1
    if count < 1 or len(data) != 84 + 50 * count:
        raise InputError(f"{path} is no binary STL file: {len(data)} bytes, {count} triangles")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(data, record, count, 84)["corners"].reshape(-1, 3)
    vertices, index = np.unique(corners.astype(np.float64), axis=0, return_inverse=True)
    with naming(path):
        return TriangleMesh(vertices, index.reshape(-1, 3))
