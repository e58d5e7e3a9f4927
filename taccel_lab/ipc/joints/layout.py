# SPDX-License-Identifier: Apache-2.0
"""Device arrays of the joints of a scene: who is coupled, by which weights, how stiffly.

Penalties follow the inertia that a joint may have to move. Its multipliers converge by a factor of
1 / (1 + k s) a round, with s the smallest response dt^2 J M^-1 J^T of the constraints to a force.
In a mechanism that is a light link between heavy ones; bounded from below by one over the mass of
all bodies that joints connect, and for turns by one over their moment of inertia about the anchor.
Penalties of ``STIFFNESS`` times those, over dt^2, need one or two rounds whatever the mass ratio.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.bodies.joints import Joint, VelocityDrive
from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.model import Model
from taccel_lab.model.embedding import control_positions, rotate

STIFFNESS = 1e4
"""Penalty over (inertia of the mechanism / dt^2)."""
_IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

wp.set_module_options({"enable_backward": False})


@wp.struct
class JointTable:
    """Joints of a scene; arrays [weight_rows, joint] have one row for all environments or one each.

    Bodies carry their frame (point, t, u, v: see ``rows``) as weights times control vectors; for
    the world and for kinematic bodies these are the origin and the axes of the frame.
    """

    kinds: wp.array(dtype=wp.int32)
    first_controls: wp.array(dtype=wp.int32)
    """First control node, shape [joint_count]."""
    second_controls: wp.array(dtype=wp.int32)
    """First control node, -1 unless affine, shape [joint_count]."""
    second_frames: wp.array(dtype=wp.int32)
    """Kinematic index, -1 unless kinematic, shape [joint_count]."""
    first_weights: wp.array2d(dtype=wp.mat44d)
    """Rows: point, t, u, v; columns: control nodes."""
    second_weights: wp.array2d(dtype=wp.mat44d)
    sizes: wp.array(dtype=wp.float64)
    """l of the turn rows [m], shape [joint_count]."""
    penalties: wp.array(dtype=wp.vec3d)
    """k dt^2 of rows 0..2 [kg], 3..5 [kg] and 6 [kg or kg m^2], shape [joint_count]."""
    limits: wp.array(dtype=wp.vec2d)
    """Smallest and largest coordinate [rad or m], shape [joint_count]."""
    gains: wp.array(dtype=wp.vec3d)
    """Stiffness, damping and largest effort of the drives, shape [joint_count]."""
    follows_rate: wp.array(dtype=wp.int32)
    """1 where the drive's target is a rate, shape [joint_count]."""
    present: wp.array2d(dtype=wp.int32)
    """1 where both bodies are present, shape [env_count, joint_count]."""


@dataclass
class JointLayout:
    """The table on the device, with what only the host needs."""

    table: JointTable
    joints: tuple[Joint, ...]
    colors: list[wp.array]
    """Joint indices in groups of which no two share a body, int32: a group runs without atomics."""
    smallest_size_m: float
    tree: wp.array
    """Joints in an order in which each has one body placed before: index, and 1 where the second
    body is the one to place, vec2i; joints that close loops are left out."""


def joint_layout(model: Model) -> JointLayout:
    """Build the arrays; ``model.scene.joints`` has been checked with the scene."""
    scene, joints = model.scene, tuple(model.scene.joints)
    affine = [body.name for body in scene.affine_bodies]
    kinematic = [body.name for body in scene.kinematic_bodies]
    solids = model.affine.properties
    controls = [
        control_positions(
            solid,
            np.atleast_2d(_IDENTITY if body.initial_pose is None else body.initial_pose),
        )
        for body, solid in zip(scene.affine_bodies, solids, strict=True)
    ]
    first = [affine.index(joint.first) for joint in joints]
    second = [affine.index(joint.second) if joint.second in affine else -1 for joint in joints]
    frames = [
        kinematic.index(joint.second)
        if joint.second in kinematic and joint.second not in affine
        else -1
        for joint in joints
    ]
    starts = model.affine.first_control + 4 * np.arange(model.affine.count)

    first_weights, second_weights = [], []
    for joint, a, b in zip(joints, first, second, strict=True):
        world = _joint_frame(joint)
        if b >= 0:
            other = controls[b]
        else:
            pose = _IDENTITY if joint.second_pose is None else joint.second_pose
            other = _frame_controls(np.atleast_2d(pose))
        first_weights.append(_weights(controls[a], world))
        second_weights.append(_weights(other, world))

    penalties = _penalties(joints, first, second, [c[0, 0] for c in controls], solids)
    sizes = np.array(
        [max(solids[i].radius_m for i in ab if i >= 0) for ab in zip(first, second, strict=True)]
    )
    penalties[:, 1] /= sizes**2
    drives = [joint.motor for joint in joints]
    gains = np.array(
        [
            (getattr(d, "stiffness", 0.0), d.damping, d.max_effort) if d else (0, 0, 0)
            for d in drives
        ]
    )
    present = np.array(
        [
            model.present.numpy()[:, model.body_id(joint.first)]
            * (1 if joint.second is None else model.present.numpy()[:, model.body_id(joint.second)])
            for joint in joints
        ]
    ).T

    def put(value: object, dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(value), dtype=dtype, device=model.device)

    table = JointTable()
    table.kinds = put([int(joint.kind) for joint in joints], wp.int32)
    table.first_controls = put(starts[first], wp.int32)
    table.second_controls = put([starts[b] if b >= 0 else -1 for b in second], wp.int32)
    table.second_frames = put(frames, wp.int32)
    table.first_weights = put(_stacked(first_weights), wp.mat44d)
    table.second_weights = put(_stacked(second_weights), wp.mat44d)
    table.sizes = put(sizes, wp.float64)
    table.penalties = put(STIFFNESS * penalties, wp.vec3d)
    table.limits = put([joint.limits for joint in joints], wp.vec2d)
    table.gains = put(gains, wp.vec3d)
    table.follows_rate = put([isinstance(d, VelocityDrive) for d in drives], wp.int32)
    table.present = put(present, wp.int32)
    return JointLayout(
        table=table,
        joints=joints,
        colors=[put(group, wp.int32) for group in _colors(first, second)],
        smallest_size_m=float(sizes.min()),
        tree=put(_tree(first, second, len(solids)), wp.vec2i),
    )


def _joint_frame(joint: Joint) -> np.ndarray:
    """Point and directions t, u, v in the world, [1 or env_count, 4, 3]."""
    point, t = np.atleast_2d(joint.anchor_m), np.atleast_2d(joint.axis)
    helper = np.eye(3)[np.argmin(np.abs(t), axis=1)]
    u = np.cross(helper, t)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.stack(np.broadcast_arrays(point, t, u, np.cross(t, u)), axis=1)


def _frame_controls(pose: np.ndarray) -> np.ndarray:
    """Origin and axes of frames at poses [n, 7], shape [n, 4, 3]."""
    axes = rotate(pose[:, None, 3:], np.eye(3))
    return np.concatenate([pose[:, None, :3], axes], axis=1)


def _weights(controls: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Weights [n, 4, 4] with which control vectors [n, 4, 3] give a frame [n, 4, 3]."""
    rows = max(len(controls), len(world))
    relative = np.array(np.broadcast_to(world, (rows, 4, 3)))
    relative[:, 0] -= controls[:, 0]
    weights = np.zeros((rows, 4, 4))
    weights[:, :, 1:] = relative @ np.linalg.inv(controls[:, 1:])
    weights[:, 0, 0] = 1.0
    return weights


def _stacked(weights: list[np.ndarray]) -> np.ndarray:
    """[rows, joint, 4, 4] with one row, or as many as there are environments."""
    rows = max(len(w) for w in weights)
    return np.stack([np.broadcast_to(w, (rows, 4, 4)) for w in weights], axis=1)


def _penalties(
    joints: tuple[Joint, ...],
    first: list[int],
    second: list[int],
    centers: list[np.ndarray],
    solids: list[MassProperties],
) -> np.ndarray:
    """Mass [kg], moment of inertia [kg m^2], and the one of the two that moves the coordinate."""
    group = np.arange(len(solids))
    for a, b in zip(first, second, strict=True):
        if b >= 0:
            group[group == group[b]] = group[a]
    result = np.zeros((len(joints), 3))
    for index, (joint, a) in enumerate(zip(joints, first, strict=True)):
        members = np.flatnonzero(group == group[a])
        mass = sum(solids[i].mass_kg for i in members)
        anchor = np.atleast_2d(joint.anchor_m)[0]
        moment = sum(
            solids[i].second_moments_kg_m2.sum()
            + solids[i].mass_kg * np.sum((centers[i] - anchor) ** 2)
            for i in members
        )
        result[index] = mass, moment, moment if joint.kind == 1 else mass
    return result


def _colors(first: list[int], second: list[int]) -> list[list[int]]:
    """Greedy colouring of joints that share a body."""
    groups: list[list[int]] = []
    used: list[set[int]] = []
    for index, bodies in enumerate(zip(first, second, strict=True)):
        mine = {body for body in bodies if body >= 0}
        for group, taken in zip(groups, used, strict=True):
            if not mine & taken:
                group.append(index)
                taken |= mine
                break
        else:
            groups.append([index])
            used.append(mine)
    return groups


def _tree(first: list[int], second: list[int], body_count: int) -> np.ndarray:
    """Breadth-first order of the joints from the world and the kinematic bodies on, then from the
    first body of what floats, shape [n, 2]."""
    placed = np.zeros(body_count, dtype=bool)
    open_joints = list(range(len(first)))
    order: list[tuple[int, int]] = []
    while open_joints:
        found = False
        for joint in list(open_joints):
            a, b = first[joint], second[joint]
            stands = b < 0 or placed[b]
            if stands or placed[a]:
                open_joints.remove(joint)
                child = a if stands else b
                if not placed[child]:
                    order.append((joint, int(not stands)))
                    placed[child] = True
                found = True
        if not found:
            placed[first[open_joints[0]]] = True
    return np.array(order, dtype=np.int32).reshape(-1, 2)
