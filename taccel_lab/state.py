# SPDX-License-Identifier: Apache-2.0
"""``State``: what a step changes, as device arrays ``[env_count, ...]``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.kinematics import place_kinematic_nodes
from taccel_lab.model import Model


@dataclass
class State:
    """Positions, velocities and prescribed poses of all environments."""

    positions: wp.array
    """Node positions [m], vec3d, shape [env_count, node_count]."""
    velocities: wp.array
    """Node velocities [m/s], vec3d, shape [env_count, node_count]; zero in quasi-static scenes."""
    poses: wp.array
    """world_from_body of the kinematic bodies, transformd, shape [env_count, body_count]."""


def as_poses(model: Model, poses: np.ndarray) -> np.ndarray:
    """Check poses (x, y, z [m], quaternion x, y, z, w), shape [env_count, body_count, 7]."""
    value = np.asarray(poses, dtype=np.float64)
    expected = (model.env_count, len(model.kinematic), 7)
    if value.shape != expected:
        raise InputError(f"poses have shape {value.shape}, expected {expected}")
    if not np.isfinite(value).all():
        raise InputError("poses hold NaN or infinite values")
    norm = np.linalg.norm(value[..., 3:], axis=-1)
    if value.size and (np.abs(norm - 1) > 1e-6).any():
        raise InputError(f"pose quaternions (x, y, z, w) must have unit length, got {norm.min():g}")
    return value


def initial_state(model: Model, poses: np.ndarray) -> State:
    """The rest shape at rest, with the kinematic bodies at ``poses`` [env_count, body_count, 7]."""
    rest = model.rest_positions.numpy()
    positions = np.repeat(rest, model.env_count // model.rest_count, axis=0)
    state = State(
        positions=wp.array(positions, dtype=wp.vec3d, device=model.device),
        velocities=wp.zeros(positions.shape[:2], dtype=wp.vec3d, device=model.device),
        poses=wp.array(as_poses(model, poses), dtype=wp.transformd, device=model.device),
    )
    place_kinematic_nodes(model, state.poses, state.positions)
    return state
