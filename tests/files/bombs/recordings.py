# SPDX-License-Identifier: Apache-2.0
"""Recordings that state frames that are not there, or are all the same."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.files.bombs.readers import Make

TOUCH = "observation.images.touch"


def hdf5(shape: tuple[int, ...], kind: Any, **layout: Any) -> Make:
    """Frames of which not one is written."""

    def make(folder: Path) -> Path:
        import h5py

        path = folder / "0.hdf5"
        dtype = h5py.vlen_dtype(np.uint8) if kind == "vlen" else kind
        with h5py.File(path, "w") as file:
            file.create_group("tactile").create_dataset("rgb", shape, dtype, **layout)
        return path

    return make


def hdf5_packed(chunk: tuple[int, ...], count: int) -> Make:
    """Chunks that are packed twice: a frame of 48 MiB takes some hundred bytes."""

    def make(folder: Path) -> Path:
        import h5py

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


def hdf5_shared(folder: Path) -> Path:
    """Twenty thousand frames that are all the same bytes of the file."""
    import h5py

    path = folder / "0.hdf5"
    large = cv2.imencode(".png", np.full((4096, 4096, 3), 90, np.uint8))[1]
    with h5py.File(path, "w") as file:
        data = file.create_group("tactile").create_dataset(
            "rgb", (20_000,), h5py.vlen_dtype(np.uint8)
        )
        data[0] = large
        at = data.id.get_offset()
    content = bytearray(path.read_bytes())
    content[at : at + 320_000] = bytes(content[at : at + 16]) * 20_000
    path.write_bytes(content)
    return path


def _info(folder: Path, version: str, kind: str) -> Path:
    root = folder / "set"
    (root / "meta").mkdir(parents=True)
    features = {"observation.images.touch": {"dtype": kind, "shape": [24, 32, 3]}}
    about = {"codebase_version": version, "total_frames": 1 << 40, "fps": 30, "features": features}
    (root / "meta" / "info.json").write_text(json.dumps(about))
    return root


def lerobot_rows(folder: Path) -> Path:
    """A hundred thousand rows that are one image of a dictionary."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    root = _info(folder, "v3.0", "image")
    (root / "data" / "chunk-000").mkdir(parents=True)
    path = root / "data" / "chunk-000" / "file-000.parquet"
    large = cv2.imencode(".png", np.full((4096, 4096, 3), 90, np.uint8))[1].tobytes()
    count = 1 << 17
    first = np.zeros(count, np.int32)
    columns = [pa.DictionaryArray.from_arrays(first, pa.array([value])) for value in (large, "x")]
    cell = pa.StructArray.from_arrays(columns, ["bytes", "path"])
    zeros = pa.array(np.zeros(count, np.int64))
    name = "observation.images.touch"
    table = pa.table({"episode_index": zeros, "frame_index": zeros, name: cell})
    pq.write_table(table, path, row_group_size=count)
    return root


def lerobot_lengths(folder: Path) -> Path:
    """Episodes of a hundred thousand frames each, and a video of two."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    name = "observation.images.touch"
    root = _info(folder, "v3.0", "video")
    of, count = f"videos/{name}/", 1000
    (root / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    zeros = [0] * count
    columns: dict[str, Any] = {"episode_index": list(range(count)), "length": [1 << 17] * count}
    columns |= {f"{of}chunk_index": zeros, f"{of}file_index": zeros}
    columns[f"{of}from_timestamp"] = [0.0] * count
    pq.write_table(pa.table(columns), root / "meta/episodes/chunk-000/file-000.parquet")
    (root / "videos" / name / "chunk-000").mkdir(parents=True)
    video(root / "videos" / name / "chunk-000" / "file-000.mp4", 2)
    return root


def lerobot_times(folder: Path) -> Path:
    """A table of times of 67 million rows."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    root = _info(folder, "v2.1", "video")
    data = root / "data" / "chunk-000"
    data.mkdir(parents=True)
    count = 1 << 22
    zeros = pa.array(np.zeros(count, np.int64))
    part = pa.table(
        {"episode_index": zeros, "frame_index": zeros, "timestamp": pa.array(np.zeros(count))}
    )
    with pq.ParquetWriter(data / "episode_000000.parquet", part.schema, compression="zstd") as file:
        for _ in range(16):
            file.write_table(part)
    videos = root / "videos/chunk-000/observation.images.touch"
    videos.mkdir(parents=True)
    video(videos / "episode_000000.mp4", 2)
    return root


def video(path: Path, count: int, size: tuple[int, int] = (64, 48)) -> Path:
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        for _ in range(count):
            still = np.full((size[1], size[0], 3), 90, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(still, "rgb24")))
        container.mux(stream.encode())
    return path


def mp4_samples(folder: Path) -> Path:
    """A video whose table of samples states four thousand million of them, of one size."""
    path = video(folder / "v.mp4", 3)
    data = bytearray(path.read_bytes())
    for mark, count_at in ((b"stsz", 12), (b"stts", 8)):
        at = data.index(mark)
        data[at + count_at : at + count_at + 4] = b"\x7f\xff\xff\xff"
        if mark == b"stsz":
            data[at + 8 : at + 12] = struct.pack(">I", 1)
    at = data.index(b"stts")
    data[at + 12 : at + 16] = b"\x7f\xff\xff\xff"[:4]
    at = data.index(b"stsz")
    data[at + 12 : at + 16] = b"\x7f\xff\xff\xff"
    path.write_bytes(data)
    return path
