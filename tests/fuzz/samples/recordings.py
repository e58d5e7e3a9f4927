# SPDX-License-Identifier: Apache-2.0
"""Recordings in the layouts of data sets."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

TOUCH = "observation.images.touch"


def _pngs() -> list[bytes]:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (3, 24, 32, 3), dtype=np.uint8)
    return [cv2.imencode(".png", image)[1].tobytes() for image in images]


def univtac(given: Path) -> None:
    """An episode with images of two fingers, of which one is read."""
    streams = _pngs()
    with h5py.File(given / "0.hdf5", "w") as file:
        for side in ("left", "right"):
            gel = file.create_group(f"tactile/{side}_tactile")
            gel.create_dataset("rgb", data=streams, dtype=f"S{max(map(len, streams))}")


def lerobot(given: Path) -> None:
    """A data set of version 3 whose images lie in its table and beside it."""
    folder = given / "set"
    (folder / "meta").mkdir(parents=True)
    features = {TOUCH: {"dtype": "image", "shape": [24, 32, 3]}}
    about = {"codebase_version": "v3.0", "total_frames": 3, "fps": 10, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(about))
    inside, beside, other = _pngs()
    (folder / "images").mkdir()
    (folder / "images" / "1.png").write_bytes(beside)
    cells = [(inside, None), (None, "images/1.png"), (other, None)]
    stored = pa.array([{"bytes": data, "path": path} for data, path in cells])
    (folder / "data" / "chunk-000").mkdir(parents=True)
    table = pa.table({"episode_index": [0] * 3, "frame_index": [0, 1, 2], TOUCH: stored})
    pq.write_table(table, folder / "data" / "chunk-000" / "file-000.parquet")
