# SPDX-License-Identifier: Apache-2.0
"""Recordings in the layouts of data sets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import av
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


def univtac_packed(given: Path) -> None:
    """Levels in packed chunks and streams of any length, of which the streams are read."""
    with h5py.File(given / "0.hdf5", "w") as file:
        levels = np.random.default_rng(0).integers(0, 255, (6, 24, 32, 3), dtype=np.uint8)
        file.create_dataset("head/levels", data=levels, chunks=(4, 12, 32, 3), compression="gzip")
        stored = file.create_dataset(
            "tactile/rgb", (3,), h5py.vlen_dtype(np.uint8), chunks=(2,), compression="gzip"
        )
        for number, stream in enumerate(_pngs()):
            stored[number] = np.frombuffer(stream, np.uint8)


def set_of(given: Path, version: str, kind: str, frames: int = 3, fps: int = 10) -> Path:
    """A folder ``set`` with what it states."""
    folder = given / "set"
    (folder / "meta").mkdir(parents=True)
    features = {TOUCH: {"dtype": kind, "shape": [24, 32, 3]}}
    about = {"codebase_version": version, "total_frames": frames, "fps": fps, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(about))
    return folder


def write_table(path: Path, **columns: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path)


def write_frames(
    path: Path,
    levels: tuple[int, ...] = (40, 90, 140),
    size: tuple[int, int] = (32, 24),
    rate: int = 10,
) -> None:
    """A video of grey pictures."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        for level in levels:
            still = np.full((*size[::-1], 3), level, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(still, "rgb24")))
        container.mux(stream.encode())


def lerobot_2(given: Path) -> None:
    """A data set of version 2.1: a video and a table an episode."""
    folder = set_of(given, "v2.1", "video")
    write_frames(folder / f"videos/chunk-000/{TOUCH}/episode_000000.mp4")
    write_table(
        folder / "data/chunk-000/episode_000000.parquet",
        episode_index=[0] * 3,
        frame_index=[0, 1, 2],
        timestamp=[0.0, 0.1, 0.2],
    )


def lerobot_3(given: Path) -> None:
    """A data set of version 3: two episodes in one video."""
    folder, of = set_of(given, "v3.0", "video"), f"videos/{TOUCH}/"
    write_frames(folder / f"videos/{TOUCH}/chunk-000/file-000.mp4")
    write_table(
        folder / "data/chunk-000/file-000.parquet",
        episode_index=[0, 0, 1],
        frame_index=[0, 1, 0],
        timestamp=[0.0, 0.1, 0.0],
    )
    indices = {f"{of}{name}_index": [0, 0] for name in ("chunk", "file")}
    starts = {f"{of}from_timestamp": [0.0, 0.2]}
    write_table(
        folder / "meta/episodes/chunk-000/file-000.parquet",
        episode_index=[0, 1],
        length=[2, 1],
        **indices,
        **starts,
    )


def lerobot(given: Path) -> None:
    """A data set of version 3 whose images lie in its table and beside it."""
    folder = set_of(given, "v3.0", "image")
    inside, beside, other = _pngs()
    (folder / "images").mkdir()
    (folder / "images" / "1.png").write_bytes(beside)
    cells = [(inside, None), (None, "images/1.png"), (other, None)]
    stored = pa.array([{"bytes": data, "path": path} for data, path in cells])
    columns = {"episode_index": [0] * 3, "frame_index": [0, 1, 2], TOUCH: stored}
    write_table(folder / "data" / "chunk-000" / "file-000.parquet", **columns)
