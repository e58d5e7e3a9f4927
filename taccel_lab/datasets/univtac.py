# SPDX-License-Identifier: Apache-2.0
"""Export to the names that UniVTAC's HDF5 files have (univtac/UniVTAC, ``envs/_base_task.py`` and
``envs/utils/data.py``): a file an episode, ``hdf5/N.hdf5``, and ``metadata.json``.

One gel is there, as ``tactile/left_tactile``. Images are PNG streams in fixed-length strings, which
UniVTAC's reader decodes as it does its own JPEG, but losslessly; colours are in its order (RGB
handed to the encoder as they are).
"""

from __future__ import annotations

from collections.abc import Sequence
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

GEL = "left_tactile"
LEFT_OUT = (
    "observation (no camera looks on), right_tactile, tactile/*/rgb_marker (rgb shows the dots "
    "of a sensor that has some), embodiment/joint (no robot)"
)


def export_univtac(folders: Sequence[Path | str], out: Path | str) -> int:
    """Write ``out``; returns the number of episodes. Episodes without a step are left out.

    Raises InputError for a data set without rgb or depth_mm.
    """
    require_outside(out)
    data = Dataset(folders)
    for name in ("rgb", "depth_mm"):
        if name not in data.channels:
            raise InputError(f"the data set has no {name}, which UniVTAC's files need")
    described: dict[str, Any] = {}
    with atomic_directory(out) as staging:
        (staging / "hdf5").mkdir()
        for number, row in enumerate(data.episodes):
            if not row["rows"]:
                continue
            name = str(len(described))
            write_by(staging / "hdf5" / f"{name}.hdf5", partial(_write_episode, data, number))
            described[name] = row
        if not described:
            raise InputError("the data set has no step")
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
    import cv2

    streams = [cv2.imencode(".png", image)[1].tobytes() for image in images]
    group.create_dataset(name, data=streams, dtype=f"S{max(map(len, streams))}")


def _camera_distance_mm(data: Dataset, number: int) -> float:
    """Distance from the camera to the face at rest along z, where the profile knows; else 0."""
    optics = data.profile(number).optics
    return 0.0 if optics is None else abs(float(optics.position_mm[2]))
