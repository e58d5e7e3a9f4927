# SPDX-License-Identifier: Apache-2.0
"""Prescribed rigid motion: poses between two ends, and the nodes that a frame carries."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.model.launches import launch
from taccel_lab.model.model import Model

wp.set_module_options({"enable_backward": False})


@wp.func
def turn_between(first: wp.quatd, second: wp.quatd) -> wp.float64:
    """Angle between two rotations [rad], the short way round."""
    # From the chord, not from the dot product: the arccosine of nearly 1 has only eight digits.
    minus = wp.float64(0.0)
    plus = wp.float64(0.0)
    for k in range(4):
        minus += (second[k] - first[k]) * (second[k] - first[k])
        plus += (second[k] + first[k]) * (second[k] + first[k])
    chord = wp.sqrt(wp.min(minus, plus))
    return wp.float64(4.0) * wp.asin(wp.min(wp.float64(0.5) * chord, wp.float64(1.0)))


@wp.func
def pose_between(start: wp.transformd, end: wp.transformd, fraction: wp.float64) -> wp.transformd:
    """A pose part of the way: linear in position, constant angular velocity the short way round."""
    one = wp.float64(1.0)
    p = wp.transform_get_translation(start)
    p = p + fraction * (wp.transform_get_translation(end) - p)
    qa = wp.transform_get_rotation(start)
    qb = wp.transform_get_rotation(end)
    cosine = qa[0] * qb[0] + qa[1] * qb[1] + qa[2] * qb[2] + qa[3] * qb[3]
    side = one
    if cosine < wp.float64(0.0):
        side = -one
    angle = wp.acos(wp.min(wp.abs(cosine), one))
    sine = wp.sin(angle)
    wa = one - fraction
    wb = fraction
    if sine >= wp.float64(1.0e-6):
        wa = wp.sin((one - fraction) * angle) / sine
        wb = wp.sin(fraction * angle) / sine
    wb = side * wb
    q = wp.quatd(
        wa * qa[0] + wb * qb[0],
        wa * qa[1] + wb * qb[1],
        wa * qa[2] + wb * qb[2],
        wa * qa[3] + wb * qb[3],
    )
    return wp.transformd(p, wp.normalize(q))


@wp.func
def chord_error(radius: wp.float64, angle: wp.float64) -> wp.float64:
    """How far a vertex at ``radius`` [m] of a body that turns by ``angle`` may leave its chord."""
    return radius * (wp.float64(1.0) - wp.cos(wp.float64(0.5) * angle))


@wp.func
def turn_within(radius: wp.float64, gap: wp.float64) -> wp.float64:
    """Angle [rad] whose arc leaves its chord by half of ``gap`` at ``radius`` [m]."""
    one = wp.float64(1.0)
    bound = one - wp.float64(0.5) * gap / wp.max(radius, wp.float64(1.0e-300))
    return wp.float64(2.0) * wp.acos(wp.clamp(bound, -one, one))


@wp.kernel
def _interpolate_kernel(
    mask: wp.array(dtype=wp.int32),
    start: wp.array2d(dtype=wp.transformd),
    end: wp.array2d(dtype=wp.transformd),
    fractions: wp.array(dtype=wp.float64),
    result: wp.array2d(dtype=wp.transformd),
):
    env, body = wp.tid()
    if mask[env] != 0:
        result[env, body] = pose_between(start[env, body], end[env, body], fractions[env])


def place_poses_between(
    mask: wp.array, start: wp.array, end: wp.array, fractions: wp.array, result: wp.array
) -> None:
    """Poses part of the way (float64, [env_count]) in the environments of ``mask``; transformd,
    [env_count, kinematic_count]."""
    if result.size:
        launch(_interpolate_kernel, result.shape, mask, start, end, fractions, result)


def interpolate_poses(start: np.ndarray, end: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """``place_poses_between`` for the host; poses [env, body, 7], ``fraction`` [env]."""
    first = wp.array(np.ascontiguousarray(start), dtype=wp.transformd)
    last = wp.array(np.ascontiguousarray(end), dtype=wp.transformd)
    result = wp.empty_like(first)
    mask = wp.full(len(fraction), 1, dtype=wp.int32)
    place_poses_between(mask, first, last, wp.array(fraction, dtype=wp.float64), result)
    return result.numpy().reshape(start.shape)


@wp.kernel
def _place_kinematic_kernel(
    mask: wp.array(dtype=wp.int32),
    nodes: wp.array(dtype=wp.int32),
    frames: wp.array(dtype=wp.int32),
    rest_positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
):
    env, i = wp.tid()
    if mask:
        if mask[env] == 0:
            return
    node = nodes[i]
    rest = rest_positions[env % rest_positions.shape[0], node]
    positions[env, node] = wp.transform_point(poses[env, frames[i]], rest)


def _place(
    model: Model, what: tuple[wp.array, wp.array], poses: wp.array, positions: wp.array, mask: Any
) -> None:
    nodes, frames = what
    if len(nodes):
        inputs = [mask, nodes, frames, model.rest_positions, poses, positions]
        launch(_place_kinematic_kernel, (model.env_count, len(nodes)), *inputs)


def place_kinematic_nodes(
    model: Model, poses: wp.array, positions: wp.array, mask: wp.array | None = None
) -> None:
    """Put the nodes that follow a frame where it carries them at ``poses``.

    Those are the vertices of kinematic bodies, and the bonded nodes of mounted gels. ``mask``:
    int32, [env_count]; all environments when None.
    """
    _place(model, (model.frame_nodes, model.frame_ids), poses, positions, mask)


def place_at_start(
    model: Model, poses: wp.array, positions: wp.array, mask: wp.array | None = None
) -> None:
    """Places nodes as ``place_kinematic_nodes`` does, and mounted gels with all their nodes, in
    their rest shape."""
    _place(model, (model.start_nodes, model.start_frames), poses, positions, mask)
