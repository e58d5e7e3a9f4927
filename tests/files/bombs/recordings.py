# SPDX-License-Identifier: Apache-2.0
"""Recordings that state frames that are not there, or are all the same."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.files.bombs.written import Make, written
from tests.fuzz.samples.recordings import TOUCH, set_of, write_frames, write_table


def hdf5(shape: tuple[int, ...], kind: Any, **layout: Any) -> Make:
    """Frames of which not one is written."""

    def make(folder: Path) -> Path:
        path = folder / "0.hdf5"
        dtype = h5py.vlen_dtype(np.uint8) if kind == "vlen" else kind
        with h5py.File(path, "w") as file:
            file.create_group("tactile").create_dataset("rgb", shape, dtype, **layout)
        return path

    return make


def hdf5_packed(chunk: tuple[int, ...], count: int) -> Make:
    """Chunks that are packed twice: a frame of 48 MiB takes some hundred bytes."""

    def make(folder: Path) -> Path:
        path = folder / "0.hdf5"
        size = int(np.prod(chunk))
        press = zlib.compressobj(9)
        once = b"".join([*(press.compress(bytes(1 << 20)) for _ in range(size >> 20))])
        once += press.compress(bytes(size & 0xFFFFF)) + press.flush()
        packed = zlib.compress(once, 9)
        with h5py.File(path, "w") as file:
            at = file.create_group("tactile")
            about = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            about.set_chunk(chunk)
            about.set_deflate(9)
            about.set_deflate(9)
            space = h5py.h5s.create_simple((count * chunk[0], *chunk[1:]))
            data = h5py.h5d.create(at.id, b"rgb", h5py.h5t.STD_U8LE, space, dcpl=about)
            for number in range(count):
                data.write_direct_chunk((number * chunk[0], 0, 0, 0), packed)
        return path

    return make


def _large() -> bytes:
    """A picture of 48 MiB."""
    return cv2.imencode(".png", np.full((4096, 4096, 3), 90, np.uint8))[1].tobytes()


def hdf5_shared(folder: Path) -> Path:
    """Twenty thousand frames that are all the same bytes of the file."""
    path = folder / "0.hdf5"
    large = np.frombuffer(_large(), np.uint8)
    with h5py.File(path, "w") as file:
        at = file.create_group("tactile")
        data = at.create_dataset("rgb", (20_000,), h5py.vlen_dtype(np.uint8))
        data[0] = large
        at = data.id.get_offset()
    content = bytearray(path.read_bytes())
    content[at : at + 320_000] = bytes(content[at : at + 16]) * 20_000
    path.write_bytes(content)
    return path


def _set(folder: Path, version: str, kind: str) -> Path:
    return set_of(folder, version, kind, 1 << 40, 30)


def _still(path: Path, count: int) -> None:
    write_frames(path, (90,) * count, (64, 48), 30)


def lerobot_rows(folder: Path) -> Path:
    """A hundred thousand rows that are one image of a dictionary."""
    root, count = _set(folder, "v3.0", "image"), 1 << 17
    first, zeros = np.zeros(count, np.int32), pa.array(np.zeros(count, np.int64))
    columns = [
        pa.DictionaryArray.from_arrays(first, pa.array([value])) for value in (_large(), "x")
    ]
    cell = pa.StructArray.from_arrays(columns, ["bytes", "path"])
    table = pa.table({"episode_index": zeros, "frame_index": zeros, TOUCH: cell})
    (root / "data" / "chunk-000").mkdir(parents=True)
    path = root / "data" / "chunk-000" / "file-000.parquet"
    pq.write_table(table, path, row_group_size=count)
    return root


def lerobot_lengths(folder: Path) -> Path:
    """Episodes of a hundred thousand frames each, and a video of two."""
    root, of, count = _set(folder, "v3.0", "video"), f"videos/{TOUCH}/", 1000
    columns: dict[str, Any] = {"episode_index": list(range(count)), "length": [1 << 17] * count}
    columns |= {f"{of}{name}_index": [0] * count for name in ("chunk", "file")}
    columns[f"{of}from_timestamp"] = [0.0] * count
    write_table(root / "meta/episodes/chunk-000/file-000.parquet", **columns)
    _still(root / of / "chunk-000" / "file-000.mp4", 2)
    return root


def lerobot_times(folder: Path) -> Path:
    """A table of times of 67 million rows."""
    root, zeros = _set(folder, "v2.1", "video"), np.zeros(1 << 22, np.int64)
    columns = {"episode_index": zeros, "frame_index": zeros, "timestamp": zeros.astype(float)}
    part = pa.table(columns)
    path = root / "data" / "chunk-000" / "episode_000000.parquet"
    path.parent.mkdir(parents=True)
    with pq.ParquetWriter(path, part.schema, compression="zstd") as file:
        for _ in range(16):
            file.write_table(part)
    _still(root / "videos/chunk-000" / TOUCH / "episode_000000.mp4", 2)
    return root


def mp4_samples(folder: Path) -> Path:
    """A video whose table of samples states four thousand million of them, of one size."""
    _still(folder / "v.mp4", 3)
    data = bytearray((folder / "v.mp4").read_bytes())
    sizes, times = data.index(b"stsz"), data.index(b"stts")
    for at, value in (
        (times + 8, 0x7FFFFFFF), (times + 12, 0x7FFFFFFF), (sizes + 8, 1), (sizes + 12, 0x7FFFFFFF),
    ):  # fmt: skip
        data[at : at + 4] = struct.pack(">I", value)
    return written("v.mp4", bytes(data))(folder)
