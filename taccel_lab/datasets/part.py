# SPDX-License-Identifier: Apache-2.0
"""One part on disk: a folder that appears whole, with its arrays, tables and digests.

::

    data.zarr/            zarr v3: an array a channel, a row a step; group ``meshes``
    episodes.parquet      a row an episode: what was drawn, how it ended
    steps.parquet         a row a step: its numbers
    .taccel_lab_output    SHA-256 of every file
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.datasets.channels import ALWAYS, FAULT_COLUMNS, FAULTS, Channel, channels_of
from taccel_lab.datasets.motion import TouchRecord
from taccel_lab.datasets.simulate import joined
from taccel_lab.files.atomic_file import to_jsonable, write_by
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.signals.frame_faults import kinds_of

if TYPE_CHECKING:
    from taccel_lab.datasets.plan import DatasetPart, DatasetPlan

ARRAYS, EPISODES, STEPS = "data.zarr", "episodes.parquet", "steps.parquet"
ZSTD_LEVEL = 3
_COLUMNS = {
    "command": ("depth_mm", "shear_x_mm", "shear_y_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg"),
    "tool_pose": ("tool_x_m", "tool_y_m", "tool_z_m", "tool_qx", "tool_qy", "tool_qz", "tool_qw"),
    "wrench": ("force_x_n", "force_y_n", "force_z_n", "moment_x_nm", "moment_y_nm", "moment_z_nm"),
    "press_force_n": ("press_force_x_n", "press_force_y_n", "press_force_z_n"),
    "contact_center_mm": ("contact_center_x_mm", "contact_center_y_mm"),
    "fault_values": FAULT_COLUMNS,
}
"""Columns of the steps' table for arrays of vectors."""


@dataclass(frozen=True)
class PartData:
    """A part in memory."""

    part: DatasetPart
    channels: Sequence[Channel]
    arrays: dict[str, np.ndarray]
    """Arrays by channel, a row a step."""
    episodes: dict[str, list[Any]]
    """Columns, a row an episode."""
    meshes: list[tuple[np.ndarray, np.ndarray]]
    """Contact faces at rest of the episodes: nodes [m] and triangles."""
    frames: np.ndarray
    """gel_from_press, [episode, 7]."""

    @property
    def step_count(self) -> int:
        return len(self.arrays["step"])


def part_data(plan: DatasetPlan, part: DatasetPart, records: Sequence[TouchRecord]) -> PartData:
    """The arrays and tables of a part whose episodes were simulated, in order."""
    channels = channels_of(plan.spec.channels)
    arrays = joined(records, channels)
    rows: list[dict[str, Any]] = []
    first = 0
    for place, record in enumerate(records):
        kept = len(record.rows["step"]) if record.rows else 0
        rows.append(episode_row(plan, record, part, place, first, kept))
        first += kept
    return PartData(
        part,
        channels,
        arrays,
        {name: [row[name] for row in rows] for name in rows[0]},
        [(record.nodes_m, record.faces) for record in records],
        np.stack([record.gel_from_press for record in records]),
    )


def episode_row(
    plan: DatasetPlan, record: TouchRecord, part: DatasetPart, place: int, first: int, kept: int
) -> dict[str, Any]:
    """What the table says of an episode."""
    episode = plan.episodes[record.episode]
    sensor, spec = plan.sensors[episode.sensor], plan.spec
    put = episode.placing
    done = kept == record.wanted + 1
    return {
        "episode": episode.index,
        "part": part.index,
        "place": place,
        "first_row": first,
        "rows": kept,
        "status": "done" if done else "stopped" if kept > 1 else "failed",
        "cause": record.cause,
        "split": episode.split,
        "sensor": sensor.name,
        "sensor_index": episode.sensor,
        "unit": episode.unit,
        "profile_digest": sensor.digest,
        "object": spec.objects[episode.object].label,
        "object_index": episode.object,
        "tool": spec.objects[episode.object].tool,
        "motion": spec.motions[episode.motion].kind,
        "motion_index": episode.motion,
        "seed": spec.dataset.seed,
        "x_mm": put.x_mm,
        "y_mm": put.y_mm,
        "yaw_deg": put.yaw_deg,
        "tilt_deg": put.tilt_deg,
        "lean_deg": put.lean_deg,
        **episode.drawn,
        "friction": episode.friction,
        "young_modulus_factor": episode.young_modulus_factor,
        "steps_wanted": record.wanted,
        "light": _light_text(plan, episode),
    }


def _light_text(plan: DatasetPlan, episode: Any) -> str:
    """What changed the light, as JSON; empty where nothing did."""
    found = [plan.sensors[episode.sensor].units[episode.unit].light, plan.light(episode)]
    drawn = [
        {name: getattr(light, name)[0] for name in ("gain", "offset", "gradient")}
        for light in found
        if light is not None
    ]
    return json.dumps(to_jsonable(drawn)) if drawn else ""


def write_part(folder: Path, data: PartData, plan: DatasetPlan) -> None:
    """Write a part, which appears whole or not at all; OSError for a full disk and the like."""
    with atomic_directory(folder) as staging:
        sensor = plan.sensors[data.part.sensor]
        about = {
            "dataset": plan.spec.dataset.name,
            "plan": plan.digest,
            "part": data.part.index,
            "sensor": sensor.name,
            "profile_digest": sensor.digest,
            "episodes": list(data.part.episodes),
        }
        write_arrays(staging / ARRAYS, data, plan.spec.output.block_steps, about)
        write_table(staging / EPISODES, data.episodes)
        write_table(staging / STEPS, steps_table(data.arrays))


def write_arrays(path: Path, data: PartData, block: int, about: Mapping[str, Any]) -> None:
    """Write the arrays of a part as a zarr group; ``block`` steps to a chunk."""
    import zarr
    from zarr.codecs import ZstdCodec

    group = zarr.create_group(path, zarr_format=3, attributes=dict(about))
    codec = ZstdCodec(level=ZSTD_LEVEL)

    def put(where: Any, name: str, array: np.ndarray, rows: int, note: Mapping[str, Any]) -> None:
        size = len(array)
        chunk = max(1, min(rows, size))
        kept = where.create_array(
            name,
            shape=array.shape,
            dtype=array.dtype,
            chunks=(chunk, *(max(1, n) for n in array.shape[1:])),
            # One file an array: as many blocks as there are.
            shards=(max(1, math.ceil(size / chunk)) * chunk, *(max(1, n) for n in array.shape[1:])),
            compressors=[codec],
            attributes=dict(note),
        )
        if array.size:
            kept[:] = array

    for channel in data.channels:
        note = {"unit": channel.unit, "what": channel.what, "row": channel.shape}
        put(group, channel.name, data.arrays[channel.name], block, note)
    meshes = group.create_group("meshes")
    nodes, faces = zip(*data.meshes, strict=True)
    for name, arrays, what, fill in (
        ("nodes_m", nodes, "contact face at rest, a row an episode; NaN beyond its nodes", np.nan),
        ("faces", faces, "its triangles; -1 beyond them", -1),
    ):
        most = max(len(array) for array in arrays)
        filled = np.full((len(arrays), most, 3), fill, dtype=arrays[0].dtype)
        for row, array in zip(filled, arrays, strict=True):
            row[: len(array)] = array
        put(meshes, name, filled, len(filled), {"what": what})
    put(meshes, "gel_from_press", data.frames, len(data.frames), {"what": "object's frame, pose"})


def steps_table(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of the steps' table: all small channels, vectors by component, kinds of faults by
    their names, and the row."""
    columns: dict[str, np.ndarray] = {"row": np.arange(len(arrays["step"]))}
    for channel in (*ALWAYS, *FAULTS.values()):
        if channel.name not in arrays:
            continue
        array = arrays[channel.name]
        names = _COLUMNS.get(channel.name)
        if names is None:
            columns[channel.name] = array
        else:
            array = array.reshape(-1, len(names))
            columns |= {name: array[:, k] for k, name in enumerate(names)}
    if "faults" in columns:
        columns["faults"] = np.array(["+".join(kinds_of(int(bits))) for bits in columns["faults"]])
    return columns


def write_table(path: Path, columns: Mapping[str, Any]) -> None:
    """Write columns as Parquet."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table(dict(columns))
    write_by(path, lambda file: pq.write_table(table, file, compression="zstd"))
