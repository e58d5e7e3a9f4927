# SPDX-License-Identifier: Apache-2.0
"""Exports to other projects: to the layout of LeRobotDataset v3.0 (huggingface/lerobot,
``src/lerobot/datasets``), and to the names of UniVTAC's HDF5 files (univtac/UniVTAC,
``envs/_base_task.py`` and ``envs/utils/data.py``).

LeRobot's images are PNG inside the Parquet files (dtype ``image``, ``video_path`` null): lossless,
and no encoder is needed. Arrays of more than one axis are written flat, as the layout's own are.

UniVTAC has a file an episode, ``hdf5/N.hdf5``, and ``metadata.json``. One gel is there, as
``tactile/left_tactile``. Images are PNG streams in fixed-length strings, which UniVTAC's reader
decodes as it does its own JPEG, but losslessly; colours are in its order (RGB handed to the encoder
as they are).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.files.inner_path import require_outside
from taccel_lab.files.output_folder import atomic_directory

VERSION = "v3.0"
IMAGE = "observation.images.tactile"
FILE_STEPS = 2000
"""Steps of a data file, about: the layout asks for files of some 100 MB."""
CHUNK_FILES = 1000
FLAT = {
    "wrench": "observation.wrench",
    "contact_area_mm2": "observation.contact_area_mm2",
    "patch_forces_n": "observation.patch_forces_n",
    "markers_px": "observation.markers_px",
    "tool_pose": "observation.tool_pose",
    "faults": "observation.faults",
}
"""Channels and the features that they become, where a data set has them."""
LEROBOT_LEFT_OUT = (
    "depth_mm, contact_mask, normals, nodal channels, error estimates and what was drawn"
)


def _opened(
    folders: Sequence[Path | str], out: Path | str, needed: Sequence[str], layout: str
) -> tuple[Dataset, list[int]]:
    """The data set, and the places of its episodes that have steps.

    Raises InputError for one without a step or without a channel that the layout needs.
    """
    require_outside(out)
    data = Dataset(folders)
    for name in needed:
        if name not in data.channels:
            raise InputError(f"the data set has no {name}, which {layout} need")
    shown = [k for k, row in enumerate(data.episodes) if row["rows"]]
    if not shown:
        raise InputError("the data set has no step")
    return data, shown


def _png(image: np.ndarray) -> bytes:
    """An image of OpenCV's order of colours as PNG."""
    import cv2

    return cv2.imencode(".png", image)[1].tobytes()


def export_lerobot(folders: Sequence[Path | str], out: Path | str, fps: int = 10) -> dict[str, Any]:
    """Write ``out`` as a LeRobotDataset; returns its ``info.json``.

    A step is a frame, ``fps`` is nominal, since touches are quasi-static. ``observation.state`` is
    where the object was sent (mm and deg, as ``command``), ``action`` the same of the next step.

    Raises InputError for a data set without rgb or without a step.
    """
    data, shown = _opened(folders, out, ("rgb",), "LeRobot's observation.images")
    if len({data.read("rgb", data.rows_of(k)[:1]).shape for k in shown}) > 1:
        raise InputError("LeRobot wants images of one size; export each sensor's data separately")
    with atomic_directory(out) as staging:
        return _Writer(data, shown, staging, fps).write()


class _Writer:
    def __init__(self, data: Dataset, shown: list[int], root: Path, fps: int) -> None:
        self._data, self._shown, self._root, self._fps = data, shown, root, fps
        self._flat = {name: FLAT[name] for name in FLAT if name in data.channels}
        first = data.rows_of(shown[0])[:1]
        self._sizes = {
            feature: int(np.prod(data.read(name, first).shape[1:], dtype=int))
            for name, feature in self._flat.items()
        }
        self._height, self._width = data.read("rgb", first).shape[1:3]
        self._tasks = sorted({self._task(k) for k in shown})

    def _task(self, episode: int) -> str:
        row = self._data.episodes[episode]
        return f"{row['motion']} {row['object']} on {row['sensor']}"

    def write(self) -> dict[str, Any]:
        episodes, parts = [], []
        index = 0
        for number, group in enumerate(self._files()):
            chunk, file = divmod(number, CHUNK_FILES)
            frames: dict[str, list[Any]] = {}
            for episode in group:
                columns, stats = self._episode(episode, len(episodes), index)
                length = len(columns["index"])
                for name, values in columns.items():
                    frames.setdefault(name, []).extend(values)
                row = {
                    "episode_index": len(episodes),
                    "tasks": [self._task(episode)],
                    "length": length,
                    "data/chunk_index": chunk,
                    "data/file_index": file,
                    "dataset_from_index": index,
                    "dataset_to_index": index + length,
                    "meta/episodes/chunk_index": 0,
                    "meta/episodes/file_index": 0,
                }
                for feature, values in stats.items():
                    row |= {f"stats/{feature}/{what}": v for what, v in values.items()}
                episodes.append(row)
                parts.append(stats)
                index += length
            path = self._root / "data" / f"chunk-{chunk:03d}" / f"file-{file:03d}.parquet"
            self._write_frames(path, frames)
        self._write_meta(episodes, parts, index)
        info = self._info(len(episodes), index)
        write_json(self._root / "meta" / "info.json", info)
        return info

    def _files(self) -> Iterator[list[int]]:
        group: list[int] = []
        steps = 0
        for episode in self._shown:
            group.append(episode)
            steps += int(self._data.episodes[episode]["rows"])
            if steps >= FILE_STEPS:
                yield group
                group, steps = [], 0
        if group:
            yield group

    def _episode(
        self, episode: int, number: int, index: int
    ) -> tuple[dict[str, list[Any]], dict[str, Any]]:
        rows = self._data.rows_of(episode)
        count = len(rows)
        images = self._data.read("rgb", rows)
        encoded = [{"bytes": _png(image[..., ::-1]), "path": None} for image in images]
        state = self._data.read("command", rows).astype(np.float32)
        action = state[np.minimum(np.arange(count) + 1, count - 1)]
        numeric = {"observation.state": state, "action": action}
        for name, feature in self._flat.items():
            values = self._data.read(name, rows).reshape(count, -1)
            numeric[feature] = values.astype(np.float32)
        stamps = np.arange(count, dtype=np.float32) / self._fps
        whole = {
            "timestamp": stamps,
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "index": index + np.arange(count),
            "task_index": np.full(count, self._tasks.index(self._task(episode))),
        }
        columns: dict[str, list[Any]] = {IMAGE: encoded}
        columns |= {
            name: list(v) if v.shape[1] > 1 else v[:, 0].tolist() for name, v in numeric.items()
        }
        columns |= {name: values.tolist() for name, values in whole.items()}
        stats = {name: _stats(values) for name, values in numeric.items()}
        stats |= {name: _stats(values[:, None]) for name, values in whole.items()}
        pixels = images.reshape(-1, 3).astype(np.float64) / 255
        # One entry a channel, shaped [3, 1, 1] as the images are in torch.
        stats[IMAGE] = {
            what: [count] if what == "count" else [[[x]] for x in values]
            for what, values in _stats(pixels).items()
        }
        return columns, stats

    def _features(self) -> dict[str, Any]:
        names = ["depth_mm", "shear_x_mm", "shear_y_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg"]
        features: dict[str, Any] = {
            IMAGE: {
                "dtype": "image",
                "shape": [self._height, self._width, 3],
                "names": ["height", "width", "channels"],
            },
            "observation.state": {"dtype": "float32", "shape": [6], "names": names},
            "action": {"dtype": "float32", "shape": [6], "names": names},
        }
        for feature, size in self._sizes.items():
            features[feature] = {"dtype": "float32", "shape": [size], "names": None}
        for name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
            dtype = "float32" if name == "timestamp" else "int64"
            features[name] = {"dtype": dtype, "shape": [1], "names": None}
        return features

    def _info(self, episodes: int, frames: int) -> dict[str, Any]:
        return {
            "codebase_version": VERSION,
            "robot_type": None,
            "total_episodes": episodes,
            "total_frames": frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK_FILES,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": self._features(),
        }

    def _write_frames(self, path: Path, frames: dict[str, list[Any]]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        fields, described = [], {}
        for name, about in self._features().items():
            if about["dtype"] == "image":
                kind: Any = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
                described[name] = {"_type": "Image"}
            elif about["shape"] == [1]:
                kind = pa.float32() if about["dtype"] == "float32" else pa.int64()
                described[name] = {"dtype": about["dtype"], "_type": "Value"}
            else:
                kind = pa.list_(pa.float32(), about["shape"][0])
                value = {"dtype": "float32", "_type": "Value"}
                described[name] = {
                    "feature": value, "length": about["shape"][0], "_type": "Sequence",
                }  # fmt: skip
            fields.append(pa.field(name, kind))
        # As the library ``datasets`` writes it, which tells images from structures by it.
        note = {"huggingface": json.dumps({"info": {"features": described}})}
        schema = pa.schema(fields, metadata=note)
        table = pa.table({name: pa.array(frames[name], schema.field(name).type)
                          for name in schema.names}, schema=schema)  # fmt: skip
        write_by(path, lambda file: pq.write_table(table, file, compression="snappy"))

    def _write_meta(
        self, episodes: list[dict[str, Any]], parts: list[dict[str, Any]], frames: int
    ) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        meta = self._root / "meta"
        path = meta / "episodes" / "chunk-000" / "file-000.parquet"
        listed = pa.Table.from_pylist(episodes)
        write_by(path, lambda file: pq.write_table(listed, file, compression="snappy"))
        # Read by pandas with the task as its index.
        tasks = pa.table({"task_index": list(range(len(self._tasks))), "task": self._tasks})
        described = [
            {"name": n, "field_name": n, "pandas_type": p, "numpy_type": t, "metadata": None}
            for n, p, t in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
        ]
        note = {"index_columns": ["task"], "column_indexes": [], "columns": described}
        tasks = tasks.replace_schema_metadata({"pandas": json.dumps(note)})
        write_by(meta / "tasks.parquet", lambda file: pq.write_table(tasks, file))
        write_json(meta / "stats.json", {name: _gathered([p[name] for p in parts])
                                         for name in parts[0]})  # fmt: skip


def _stats(values: np.ndarray) -> dict[str, list[Any]]:
    """Statistics of [n, k]: least, greatest, mean and standard deviation by column, and n."""
    values = values.astype(np.float64)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
    }


def _gathered(parts: list[dict[str, list[Any]]]) -> dict[str, Any]:
    """Statistics of several sets of numbers together."""
    count = np.array([part["count"][0] for part in parts], dtype=np.float64)
    mean = np.stack([np.asarray(part["mean"]) for part in parts])
    std = np.stack([np.asarray(part["std"]) for part in parts])
    share = (count / count.sum()).reshape(-1, *(1,) * (mean.ndim - 1))
    whole = (share * mean).sum(axis=0)
    variance = (share * (std**2 + (mean - whole) ** 2)).sum(axis=0)
    return {
        "min": np.min([part["min"] for part in parts], axis=0).tolist(),
        "max": np.max([part["max"] for part in parts], axis=0).tolist(),
        "mean": whole.tolist(),
        "std": np.sqrt(variance).tolist(),
        "count": [int(count.sum())],
    }


GEL = "left_tactile"
UNIVTAC_LEFT_OUT = (
    "observation (no camera looks on), right_tactile, tactile/*/rgb_marker (rgb shows the dots "
    "of a sensor that has some), embodiment/joint (no robot)"
)


def export_univtac(folders: Sequence[Path | str], out: Path | str) -> int:
    """Write ``out``; returns the number of episodes. Episodes without a step are left out.

    Raises InputError for a data set without rgb or depth_mm.
    """
    data, shown = _opened(folders, out, ("rgb", "depth_mm"), "UniVTAC's files")
    described: dict[str, Any] = {}
    with atomic_directory(out) as staging:
        (staging / "hdf5").mkdir()
        for place, number in enumerate(shown):
            path = staging / "hdf5" / f"{place}.hdf5"
            write_by(path, partial(_write_episode, data, number))
            described[str(place)] = data.episodes[number]
        write_json(staging / "metadata.json", described)
    return len(described)


def _write_episode(data: Dataset, number: int, stream: BytesIO) -> None:
    import h5py

    row = data.episodes[number]
    steps = data.rows_of(number)
    base_mm = _camera_distance_mm(data, number)
    with h5py.File(stream, "w") as file:
        gel = file.create_group("tactile").create_group(GEL)
        _put_images(gel, "rgb", data.read("rgb", steps))
        depth = gel.create_dataset(
            "depth", data=(base_mm - data.read("depth_mm", steps)).astype(np.float32)
        )
        depth.attrs["unit"] = "mm"
        depth.attrs["what"] = "from the camera along its axis" if base_mm else "height over rest"
        if "markers_px" in data.channels:
            there = data.read("markers_px", steps).astype(np.float32)
            rest = np.broadcast_to(there[:1], there.shape)
            gel.create_dataset("marker", data=np.stack([rest, there], axis=1))
        if "node_moved_mm" in data.channels:
            nodes, _ = data.mesh(number)
            moved = data.read("node_moved_mm", steps)[:, : len(nodes)]
            points = gel.create_dataset("points", data=(nodes + 1e-3 * moved).astype(np.float32))
            points.attrs["unit"] = "m, gel frame: nodes of the contact face"
        # The gel rests; the object moves. Quaternions are w, x, y, z there.
        still = np.zeros((len(steps), 7), dtype=np.float32)
        still[:, 3] = 1
        gel.create_dataset("pose", data=still)
        pose = data.read("tool_pose", steps)[:, [0, 1, 2, 6, 3, 4, 5]]
        file.create_group("actor").create_dataset("object", data=pose.astype(np.float32))
        embodiment = file.create_group("embodiment")
        embodiment.create_dataset("ee", data=pose.astype(np.float32))
        file.create_dataset("step", data=data.steps["step"][steps].astype(np.int64))
        atom = file.create_group("atom")
        pressed = data.steps["step"][steps]
        atom.create_dataset("id", data=(pressed > 0).astype(np.int64))
        tags = np.where(pressed > 0, str(row["motion"]), "rest").astype("S")
        atom.create_dataset("tag", data=tags)
        # Names of ours, beside theirs.
        labels = file.create_group("taccel_lab")
        for name in ("wrench", "contact_area_mm2", "patch_forces_n", "contact_mask"):
            if name in data.channels:
                labels.create_dataset(name, data=data.read(name, steps))


def _put_images(group: Any, name: str, images: np.ndarray) -> None:
    streams = [_png(image) for image in images]
    group.create_dataset(name, data=streams, dtype=f"S{max(map(len, streams))}")


def _camera_distance_mm(data: Dataset, number: int) -> float:
    """Distance from the camera to the face at rest along z, where the profile knows; else 0."""
    optics = data.profile(number).optics
    return 0.0 if optics is None else abs(float(optics.position_mm[2]))
