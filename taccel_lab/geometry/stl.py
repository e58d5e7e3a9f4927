# SPDX-License-Identifier: Apache-2.0
"""Binary STL files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER_BYTES = 80


def write_stl(path: Path, corners: np.ndarray, title: str) -> None:
    """Write triangles, [n, 3, 3], in the unit of their numbers: STL itself names none.

    ``title`` says in the file's first 80 bytes what it is.
    """
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    triangles = np.zeros(len(corners), dtype=_RECORD)
    # Of one without area, zero.
    triangles["normal"] = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    triangles["corners"] = corners
    header = title.encode("ascii", "replace")[:_HEADER_BYTES].ljust(_HEADER_BYTES, b"\0")
    count = np.array(len(triangles), dtype="<u4").tobytes()
    path.write_bytes(header + count + triangles.tobytes())
