# SPDX-License-Identifier: Apache-2.0
"""A recorded seed on disk, to be looked at from all sides."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.files.documents import read_json
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.regular_file import shown

REPLAY = "replay.json"
KINDS = ("soft", "affine", "kinematic")
_ARRAYS = "replay.npz"


@dataclass(frozen=True)
class ReplayBody:
    """The surface of a body in every frame."""

    name: str
    kind: str
    """soft, affine or kinematic."""
    vertices_m: np.ndarray
    """Float32 [frame, vertex, 3]."""
    faces: np.ndarray


@dataclass(frozen=True)
class TaskReplay:
    """Frames of one seed."""

    task: str
    seed: int
    cause: str
    """Why the seed failed; empty for success."""
    times_s: np.ndarray
    """[frame]."""
    bodies: list[ReplayBody]
    forces_n: dict[str, np.ndarray]
    """Forces by name, [frame]."""
    depth_m: np.ndarray
    """Depths as of ``GelSnapshot``, float32 [frame, height_px, width_px]."""
    pressure_pa: np.ndarray
    """Float32 [frame, height_px, width_px]."""
    markers_px: np.ndarray
    """Float32 [frame, marker, 2]."""
    rgb: np.ndarray
    """Tactile images, uint8 [frame, height_px, width_px, 3]."""

    @property
    def outcome(self) -> str:
        """Success or failure, in words."""
        return f"failure: {self.cause}" if self.cause else "success"


def write_replay(replay: TaskReplay, folder: Path) -> None:
    """Write ``replay.json`` and ``replay.npz`` into a folder that exists."""
    names = ("times_s", "depth_m", "pressure_pa", "markers_px", "rgb")
    arrays = {name: getattr(replay, name) for name in names}
    arrays["forces_n"] = np.stack(list(replay.forces_n.values()), axis=1)
    for k, body in enumerate(replay.bodies):
        arrays |= {f"vertices_m_{k}": body.vertices_m, f"faces_{k}": body.faces}
    write_by(folder / _ARRAYS, partial(np.savez_compressed, **arrays))
    about = {"task": replay.task, "seed": replay.seed, "cause": replay.cause}
    bodies = [{"name": body.name, "kind": body.kind} for body in replay.bodies]
    write_json(folder / REPLAY, {**about, "bodies": bodies, "forces": list(replay.forces_n)})


def read_replay(folder: Path) -> TaskReplay:
    """What ``write_replay`` wrote; InputError for anything else."""
    about = read_json(inner_path(folder, REPLAY))
    arrays = read_npz(inner_path(folder, _ARRAYS))
    try:
        bodies = [
            ReplayBody(body["name"], body["kind"], arrays[f"vertices_m_{k}"], arrays[f"faces_{k}"])
            for k, body in enumerate(about["bodies"])
        ]
        forces = {name: arrays["forces_n"][:, k] for k, name in enumerate(about["forces"])}
        replay = TaskReplay(
            about["task"], int(about["seed"]), str(about["cause"]), arrays["times_s"], bodies,
            forces, arrays["depth_m"], arrays["pressure_pa"], arrays["markers_px"],
            arrays["rgb"],
        )  # fmt: skip
        _check(replay)
        return replay
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{folder} is no replay of a task as it is recorded: {error}") from None


def _check(replay: TaskReplay) -> None:
    """ValueError for arrays that are not those of as many frames."""
    frames = replay.times_s.shape
    wanted: list[tuple[str, np.ndarray, bool]] = [
        ("times_s", replay.times_s, len(frames) == 1 and replay.times_s.size > 0),
        ("depth_m", replay.depth_m, replay.depth_m.ndim == 3 and replay.depth_m.size > 0),
        ("pressure_pa", replay.pressure_pa, replay.pressure_pa.shape == replay.depth_m.shape),
        ("markers_px", replay.markers_px, replay.markers_px.shape[2:] == (2,)),
        ("rgb", replay.rgb, replay.rgb.shape == (*replay.depth_m.shape, 3)),
        *((f"force {name}", force, force.ndim == 1) for name, force in replay.forces_n.items()),
    ]
    for k, body in enumerate(replay.bodies):
        places, faces = body.vertices_m, body.faces
        shaped = places.ndim == 3 and places.shape[2] == 3 and places.size > 0
        wanted.append((f"vertices_m_{k}", places, shaped and bool(np.isfinite(places).all())))
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise ValueError(f"faces_{k} are {faces.shape} of {faces.dtype}, not triangles")
        if faces.size and not 0 <= faces.min() <= faces.max() < places.shape[1]:
            raise ValueError(f"faces_{k} name vertices that are not there")
        if body.kind not in KINDS:
            raise ValueError(f"body {k} is {shown(body.kind)}, not {', '.join(KINDS)}")
    if not replay.bodies:
        raise ValueError("there is no body in it")
    for name, array, right in wanted:
        if not right or array.shape[:1] != frames or array.dtype.kind not in "fiu":
            raise ValueError(f"{name} is {array.shape} of {array.dtype}, for {frames} frames")
