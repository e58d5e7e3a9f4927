# SPDX-License-Identifier: Apache-2.0
"""The states of a filmed seed on disk, to be looked at from all sides."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.output import atomic_file, write_json
from taccel_lab.reading.arrays import read_npz
from taccel_lab.reading.json_file import read_json

if TYPE_CHECKING:
    from taccel_lab.tasks.film import Film

REPLAY = "replay.json"
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
class Replay:
    """Frames of one seed."""

    task: str
    times_s: np.ndarray
    """[frame]."""
    bodies: list[ReplayBody]
    forces_n: dict[str, np.ndarray]
    """By name, [frame]."""
    rises_m: np.ndarray
    """Rise of the gel's face, float32 [frame, height_px, width_px], NaN beside it."""


def write_replay(film: Film, folder: Path) -> None:
    """Write ``replay.json`` and ``replay.npz`` into a folder that exists."""
    from taccel_lab.tasks.scene_picture import surfaces

    episode = film.episode
    frames = [surfaces(episode.scene, episode.model, place) for place in film.positions_m]
    arrays: dict[str, np.ndarray] = {
        "times_s": np.array(film.times_s),
        "rises_m": np.array(film.rises_m, dtype=np.float32),
    }
    names = list(film.forces_n[0])
    arrays["forces_n"] = np.array([[row[name] for name in names] for row in film.forces_n])
    bodies = []
    for k, (kind, _, faces) in enumerate(frames[0]):
        places = np.stack([frame[k][1] for frame in frames])
        arrays[f"vertices_m_{k}"] = places.astype(np.float32)
        arrays[f"faces_{k}"] = np.asarray(faces, dtype=np.int32)
        bodies.append({"name": f"body {k}", "kind": kind.name.lower()})
    with atomic_file(folder / _ARRAYS) as staging, open(staging, "wb") as file:
        np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]
    write_json(folder / REPLAY, {"task": film.name, "bodies": bodies, "forces": names})


def read_replay(folder: Path) -> Replay:
    """What ``write_replay`` wrote; InputError for anything else."""
    about, arrays = read_json(folder / REPLAY), read_npz(folder / _ARRAYS)
    try:
        bodies = [
            ReplayBody(body["name"], body["kind"], arrays[f"vertices_m_{k}"], arrays[f"faces_{k}"])
            for k, body in enumerate(about["bodies"])
        ]
        forces = {name: arrays["forces_n"][:, k] for k, name in enumerate(about["forces"])}
        return Replay(about["task"], arrays["times_s"], bodies, forces, arrays["rises_m"])
    except (KeyError, IndexError, TypeError) as error:
        raise InputError(f"{folder} is no replay of a task as it is recorded: {error}") from None
