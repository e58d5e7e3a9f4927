# SPDX-License-Identifier: Apache-2.0
"""The channels of a data set: what is kept of each step, by name.

Those of ``ALWAYS`` are in every data set; of the others those that ``output.channels`` names. A
name that is not in the table but that ``SignalTactile`` reads is taken from there as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.gel_camera import GelCamera
from taccel_lab.datasets.sensor import Sensor
from taccel_lab.datasets.view import TouchView
from taccel_lab.errors import InputError, naming
from taccel_lab.geometry import PixelGrid
from taccel_lab.guards import require_known
from taccel_lab.model.embedding import rotate
from taccel_lab.presses.path import rolled_mm
from taccel_lab.signals.frame_operators import BITS, FIELDS
from taccel_lab.signals.tactile import SIGNALS

if TYPE_CHECKING:
    from taccel_lab.datasets.spec import DatasetOutput

FAULT_COLUMNS = tuple(
    f"{name}{part}"
    for name, kind in FIELDS[1:]
    for part in (("_red", "_green", "_blue") if kind.shape else ("",))
)
"""Columns of ``fault_values`` in the steps' table: fields of ``FrameFault`` but the kinds."""
DEPTH_STEP_MM = 2.0**-17
"""Depths are multiples of 7.6 nm: far finer than they are known, and their last bits compress."""


@dataclass(frozen=True)
class Channel:
    """One array of a data set, a row a step."""

    name: str
    dtype: str
    shape: str
    """Shape of a row, in words; empty for a number."""
    unit: str
    what: str
    read: Callable[[TouchView], np.ndarray]
    """[row, ...] of the environments that a view shows."""
    may_be_nan: bool = False


def _command(view: TouchView) -> np.ndarray:
    """Commands with what a roll adds, [row, 6]."""
    asked = view.commands.copy()
    asked[:, 1:3] += rolled_mm(view.commands, 1e3 * view.env.touch_m[view.who])
    return asked


def _friction_use(view: TouchView) -> np.ndarray:
    """Friction over the largest possible friction, 0 without contact, [row]."""
    friction, normal = view.rubbing_n
    most = (
        np.array([view.touches[env].setup.friction_coefficient for env in view.who.tolist()])
        * normal
    )
    return np.divide(friction, most, out=np.zeros(len(most)), where=most > 0)


def _contact_center(view: TouchView) -> np.ndarray:
    """Middle of the normal force, gel xy [mm], NaN without contact, [row, 2]."""
    weights = np.abs(np.einsum("rni,ri->rn", view.forces_n, _axes(view)))
    total = weights.sum(axis=1)
    with np.errstate(invalid="ignore"):
        return 1e3 * np.einsum("rn,rni->ri", weights, view.positions_m[..., :2]) / total[:, None]


def _axes(view: TouchView) -> np.ndarray:
    """Way that the objects came, against it, unit vectors, [row, 3]."""
    frames = np.stack([view.touches[env].frame for env in view.who.tolist()])
    return rotate(frames[:, 3:], np.array([0.0, 0.0, 1.0]))


def _depth(view: TouchView) -> np.ndarray:
    depth = 1e3 * view.tactile("depth_m").astype(np.float64)
    return np.rint(np.nan_to_num(depth) / DEPTH_STEP_MM) * DEPTH_STEP_MM


def _rgb(view: TouchView) -> np.ndarray:
    levels = view.levels
    for row, env in enumerate(view.who.tolist()):
        touch = view.touches[env]
        if touch.noise_levels > 0:
            noise = touch.rng(view.step, 0).standard_normal(levels.shape[1:], dtype=np.float32)
            levels[row] += np.float32(touch.noise_levels) * noise
    return view.sent(np.rint(levels.clip(0, 255)))


def _fault_values(view: TouchView) -> np.ndarray:
    """What the faults of images were, by ``FAULT_COLUMNS``, [row, value]."""
    labels = view.fault_labels
    return np.hstack([labels[name].reshape(len(labels), -1) for name, _ in FIELDS[1:]])


def _markers(view: TouchView) -> np.ndarray:
    markers = view.markers_px.copy()
    for row, env in enumerate(view.who.tolist()):
        touch = view.touches[env]
        if touch.marker_noise_px > 0:
            noise = touch.rng(view.step, 1).standard_normal(markers.shape[1:])
            markers[row] += touch.marker_noise_px * noise
    return markers


def _patch_forces(view: TouchView) -> np.ndarray:
    """Nodal forces, spread over the four patches around each node: their sum is the force and,
    within the grid of patch centres, their moment is the moment."""
    columns, rows = view.patches
    found = np.zeros((len(view.who), rows * columns, 3))
    for row, env in enumerate(view.who.tolist()):
        loaded = np.flatnonzero(np.abs(view.forces_n[row]).sum(axis=1) > 0)
        uv = view.camera(env).pixel_from_gel(view.positions_m[row, loaded] * 1e3)
        size = np.array([view.sensor.grid.width_px, view.sensor.grid.height_px])
        place = (uv + 0.5) / size * [columns, rows] - 0.5
        place = place.clip(0, [columns - 1, rows - 1])
        corner = np.minimum(np.floor(place).astype(int), [max(columns - 2, 0), max(rows - 2, 0)])
        part = place - corner
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            weight = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
            at = (corner[:, 1] + dy).clip(max=rows - 1) * columns
            at += (corner[:, 0] + dx).clip(max=columns - 1)
            np.add.at(found[row], at, weight[:, None] * view.forces_n[row, loaded])
    return found.reshape(len(view.who), rows, columns, 3)


def _moved(view: TouchView) -> np.ndarray:
    rest = np.stack([view.meshes[env].nodes_m[view.face_nodes] for env in view.who.tolist()])
    return 1e3 * (view.positions_m[:, view.face_nodes] - rest)


ALWAYS: tuple[Channel, ...] = (
    Channel("episode", "int64", "", "", "number of the episode", lambda v: v.numbers),
    Channel("step", "int32", "", "", "0 is the untouched gel",
            lambda v: np.full(len(v.who), v.step)),
    Channel("command", "float64", "6", "mm, mm, mm, deg, deg, deg",
            "asked for: depth past first touch, motion along the face x and y, rotation vector, in "
            "the object's frame at the start", _command),
    Channel("tool_pose", "float64", "7", "m, 1", "gel_from_object: place, quaternion x, y, z, w",
            lambda v: v.tool_poses),
    Channel("wrench", "float64", "6", "N, N m", "force of the gel on the object and moment about "
            "the gel's origin, gel frame", lambda v: v.wrench),
    Channel("press_force_n", "float64", "3", "N", "the force in the object's frame at the start: "
            "z is the normal force", lambda v: v.press_force_n),
    Channel("contact_area_mm2", "float32", "", "mm2", "area in contact",
            lambda v: 1e6 * v.contact_area_m2),
    Channel("contact_center_mm", "float32", "2", "mm", "middle of the normal force, gel x and y; "
            "NaN without contact", _contact_center, may_be_nan=True),
    Channel("friction_use", "float32", "", "1", "friction forces over the coefficient times normal "
            "forces, by node: 1 where all of the contact slides", _friction_use),
    Channel("residual_n", "float64", "", "N", "force residual that the step ended with",
            lambda v: v.reported("residual_n", 0.0)),
    Channel("force_error_n", "float64", "", "N", "estimated discretisation error of the normal "
            "force", lambda v: v.errors("force_n")),
    Channel("height_error_mm", "float64", "", "mm", "estimated error of the heights, rms",
            lambda v: 1e3 * v.errors("height_m")),
    Channel("newton_iterations", "int32", "", "", "of the step",
            lambda v: v.reported("newton_iterations", 0)),
    Channel("status", "uint8", "", "", "1: the step converged; rows of others are not kept",
            lambda v: v.reported("status", 1)),
)  # fmt: skip
"""Channels in every data set."""

OPTIONAL: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel("rgb", "uint8", "height, width, 3", "levels", "tactile image, lossless", _rgb),
        Channel("depth_mm", "float32", "height, width", "mm", "how far the face has sunk; 0 beside "
                "the pad", _depth),
        Channel("normals", "float32", "height, width, 3", "1", "outward normals of the face, gel "
                "frame; 0 beside the pad", lambda v: np.nan_to_num(v.tactile("normals"))),
        Channel("contact_mask", "uint8", "height, width", "", "1 where the pixel is in contact",
                lambda v: v.tactile("contact")),
        Channel("markers_px", "float32", "marker, 2", "px", "column and row of each marker",
                _markers),
        Channel("patch_forces_n", "float32", "row, column, 3", "N", "force of the gel on the object"
                " by patch of the image; their sum is the force", _patch_forces),
        Channel("node_forces_n", "float32", "node, 3", "N", "force on the object at each node of "
                "the contact face", lambda v: v.forces_n[:, v.face_nodes]),
        Channel("node_moved_mm", "float32", "node, 3", "mm", "displacement of those nodes", _moved),
        Channel("node_pressures_kpa", "float32", "node", "kPa", "contact pressure there",
                lambda v: 1e-3 * v.pressures_pa[:, v.face_nodes]),
        Channel("node_tractions_kpa", "float32", "node, 3", "kPa", "force on the object by area of "
                "the gel there", lambda v: 1e-3 * v.tractions_pa[:, v.face_nodes]),
    )
}  # fmt: skip
"""Channels by name, of ``output.channels``."""
FAULTS: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel("faults", "uint16", "", "", "kinds of faults of the image, a bit each: "
                f"{', '.join(f'{bit} {kind}' for kind, bit in BITS.items())}",
                lambda v: v.fault_labels["kinds"]),
        Channel("fault_values", "float32", str(len(FAULT_COLUMNS)), "", "what the faults were: "
                f"{', '.join(FAULT_COLUMNS)}", _fault_values),
    )
}  # fmt: skip
"""Labels of images, of a file with [faults]."""
NODAL = ("node_forces_n", "node_moved_mm", "node_pressures_kpa", "node_tractions_kpa")
"""A row is as long as the contact face of its mesh has nodes; shorter ones end with zeros."""
_YES_OR_NO = {"contact", "slipping"}


def signal_channel(name: str) -> Channel:
    """A signal of ``SignalTactile`` as a channel."""
    dtype, said = "uint8" if name in _YES_OR_NO else "float32", "as docs/signals.md"
    return Channel(
        name, dtype, said, said, "signal of the gel's surface",
        lambda view: view.tactile(name), may_be_nan=True,
    )  # fmt: skip


def known_channels() -> list[str]:
    """All names that ``output.channels`` may hold."""
    return [*OPTIONAL, *(name for name in SIGNALS if name not in OPTIONAL)]


def channels_of(names: tuple[str, ...]) -> list[Channel]:
    """What is always kept and what is requested; InputError for an unknown name."""
    found = list(ALWAYS)
    for name in names:
        if name in {channel.name for channel in ALWAYS}:
            raise InputError(f"output.channels: {name!r} is always kept; leave it out")
        with naming("output.channels"):
            known = [*known_channels(), *FAULTS]
            require_known("channel", name, known, "taccel-lab dataset channels")
        found.append(OPTIONAL.get(name) or FAULTS.get(name) or signal_channel(name))
    return found


def check_channels(output: DatasetOutput, sensor: Sensor) -> None:
    """Reject channels that a sensor lacks."""
    channels_of(output.channels)
    wanted = set(output.channels)
    if "rgb" in wanted and sensor.color is None and sensor.optics is None:
        raise InputError(
            "it has neither a colour model nor an optical design, so that rgb cannot be drawn: "
            "leave rgb out of output.channels, or take a profile of taccel-lab calibrate color"
        )
    if wanted & {"rgb_levels"} and sensor.color is None:
        raise InputError("rgb_levels needs a colour model, which its profile lacks; rgb does not")


def grid_record(grid: PixelGrid) -> dict[str, Any]:
    """A pixel grid as JSON."""
    return {name: getattr(grid, name) for name in PixelGrid.__dataclass_fields__}


def camera_record(camera: GelCamera | PixelGrid) -> dict[str, Any] | None:
    """What sees the gel in perspective, as JSON; None where pixels are those of the grid."""
    return None if isinstance(camera, PixelGrid) else camera.record()
