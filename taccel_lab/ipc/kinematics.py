# SPDX-License-Identifier: Apache-2.0
"""Prescribed rigid motion: poses between two ends, and the nodes that a frame carries."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _place_kernel(
    nodes: wp.array(dtype=wp.int32),
    frames: wp.array(dtype=wp.int32),
    rest_positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
):
    env, i = wp.tid()
    node = nodes[i]
    rest = rest_positions[env % rest_positions.shape[0], node]
    positions[env, node] = wp.transform_point(poses[env, frames[i]], rest)


def place_kinematic_nodes(model: Model, poses: wp.array, positions: wp.array) -> None:
    """Put the nodes that follow a frame where it carries them at ``poses``.

    Those are the vertices of kinematic bodies, and the bonded nodes of mounted gels.
    """
    if len(model.frame_nodes):
        wp.launch(
            _place_kernel,
            dim=(model.env_count, len(model.frame_nodes)),
            inputs=[model.frame_nodes, model.frame_ids, model.rest_positions, poses],
            outputs=[positions],
            device=model.device,
        )


def turn_angle(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Angle between the rotations of two sets of poses [rad]; both [..., 7]."""
    qa, qb = start[..., 3:], end[..., 3:]
    # From the chord, not from the dot product: the arccosine of nearly 1 has only eight digits.
    chord = np.minimum(np.linalg.norm(qb - qa, axis=-1), np.linalg.norm(qb + qa, axis=-1))
    return 4 * np.arcsin(np.clip(chord / 2, 0, 1))


def chord_error(start: np.ndarray, end: np.ndarray, radii_m: np.ndarray) -> float:
    """How far a vertex of a turning body may leave the chord of its arc [m].

    ``start``, ``end``: [env, body, 7]; ``radii_m``: reach of each body from its origin, [body].
    """
    angle = turn_angle(start, end).max(axis=0, initial=0.0)
    return float((radii_m * (1 - np.cos(angle / 2))).max(initial=0.0))


def interpolate_poses(start: np.ndarray, end: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Poses part of the way: linear in position, constant angular velocity in rotation.

    ``start``, ``end``: [env, body, 7]; ``fraction``: [env]. Takes the short way round.
    """
    t = np.asarray(fraction)[:, None, None]
    pose = start + t * (end - start)
    qa, qb = start[..., 3:], end[..., 3:]
    dot = np.einsum("ebi,ebi->eb", qa, qb)[..., None]
    qb = np.where(dot < 0, -qb, qb)
    angle = np.arccos(np.clip(np.abs(dot), 0, 1))
    sine = np.sin(angle)
    small = sine < 1e-6
    safe = np.where(small, 1.0, sine)
    wa = np.where(small, 1 - t, np.sin((1 - t) * angle) / safe)
    wb = np.where(small, t, np.sin(t * angle) / safe)
    q = wa * qa + wb * qb
    pose[..., 3:] = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return pose
