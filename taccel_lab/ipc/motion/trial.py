# SPDX-License-Identifier: Apache-2.0
"""Where nodes are part of the way ahead: those that go straight, and those that follow a frame.

Affine bodies (``affine.bent_step``) go other ways. Each of the three places its own nodes and reads
none of the others', so that they run side by side.

Of nodes that follow a frame, each thread takes some and finds the pose of that frame itself, so
that pose and nodes are one launch; on the CPU a frame has one thread.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from taccel_lab.ipc.device.sums import BLOCK_THREADS
from taccel_lab.model import Model
from taccel_lab.model.embedding import vertex_range
from taccel_lab.model.env_lists import EnvMask, Envs, env_at, place_count
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.kinematics import pose_between
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})


@wp.struct
class Trial:
    """A part of the way ahead, and where it leads.

    curved: those of them in which a node may leave the straight way, [env_count].
    fractions: part of the way, [env_count].
    positions, displacements: start and way of the nodes [m], [env_count, node_count].
    result: where they are then [m]; paths: how they got there, of environments in ``curved`` [m].
    """

    curved: wp.array(dtype=wp.int32)
    fractions: wp.array(dtype=wp.float64)
    positions: wp.array2d(dtype=wp.vec3d)
    displacements: wp.array2d(dtype=wp.vec3d)
    result: wp.array2d(dtype=wp.vec3d)
    paths: wp.array2d(dtype=wp.vec3d)


@wp.func
def straight(env: int, node: int, t: Trial) -> wp.vec3d:
    """Where a node is that goes straight [m]."""
    return t.positions[env, node] + t.fractions[env] * t.displacements[env, node]


@wp.func
def put_node(env: int, node: int, x: wp.vec3d, t: Trial):
    """Note where a node is [m]."""
    t.result[env, node] = x
    if t.curved[env] != 0:
        t.paths[env, node] = x - t.positions[env, node]


@wp.kernel
def _straight_kernel(active: Envs, nodes: wp.array(dtype=wp.int32), t: Trial):
    place, i = wp.tid()
    env = env_at(place, active)
    if env >= 0:
        put_node(env, nodes[i], straight(env, nodes[i], t), t)


class StraightNodes:
    """Nodes that follow neither a frame nor an affine body."""

    def __init__(self, model: Model) -> None:
        self._model = model
        others = np.ones(model.node_count, dtype=bool)
        others[model.frame_nodes.numpy()] = False
        others[model.affine.first_control : vertex_range(model)[1]] = False
        others[model.affine.carried.numpy()] = False
        nodes = np.flatnonzero(others).astype(np.int32)
        self.nodes = wp.array(nodes, dtype=wp.int32, device=model.device)

    def place(self, active: EnvMask, trial: Trial) -> None:
        """Put them where ``trial`` leads, in the environments of ``active``."""
        if len(self.nodes):
            shape = (self._model.env_count, len(self.nodes))
            launch(_straight_kernel, shape, active, self.nodes, trial)


@wp.struct
class FrameMotion:
    """Nodes by frame, and the frames' ways.

    nodes: those of the first frame, then those of the second.
    node_starts: first of each frame in ``nodes``, and the end, [kinematic_count + 1].
    rest_positions: in the frame [m], [rest_count, node_count].
    starts, ends: poses, [env_count, kinematic_count].
    fractions: part of the way between them, [env_count]; without any the end is meant.
    poses: the poses there, written where there are fractions, [env_count, kinematic_count].
    lanes: threads a frame.
    """

    nodes: wp.array(dtype=wp.int32)
    node_starts: wp.array(dtype=wp.int32)
    rest_positions: wp.array2d(dtype=wp.vec3d)
    starts: wp.array2d(dtype=wp.transformd)
    ends: wp.array2d(dtype=wp.transformd)
    fractions: wp.array(dtype=wp.float64)
    poses: wp.array2d(dtype=wp.transformd)
    lanes: wp.int32


@wp.func
def frame_pose(env: int, frame: int, lane: int, m: FrameMotion) -> wp.transformd:
    """The pose of a frame, which its first lane writes."""
    if m.fractions.shape[0] == 0:
        return m.ends[env, frame]
    pose = pose_between(m.starts[env, frame], m.ends[env, frame], m.fractions[env])
    if lane == 0:
        m.poses[env, frame] = pose
    return pose


@wp.func
def is_idle(frame: int, lane: int, m: FrameMotion) -> bool:
    """Whether there is no node for a lane, nor a pose to write."""
    return lane > 0 and m.node_starts[frame] + lane >= m.node_starts[frame + 1]


@wp.func
def carried(env: int, node: int, pose: wp.transformd, m: FrameMotion) -> wp.vec3d:
    """Where a frame at ``pose`` carries a node [m]."""
    return wp.transform_point(pose, m.rest_positions[env % m.rest_positions.shape[0], node])


@wp.kernel
def _aim_nodes_kernel(
    active: Envs,
    moving: wp.array(dtype=wp.int32),
    m: FrameMotion,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
):
    place, frame, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    if is_idle(frame, lane, m):
        return
    pose = frame_pose(env, frame, lane, m)
    for i in range(m.node_starts[frame] + lane, m.node_starts[frame + 1], m.lanes):
        node = m.nodes[i]
        displacement = wp.vec3d()
        if moving[env] != 0:
            displacement = carried(env, node, pose, m) - positions[env, node]
        displacements[env, node] = displacement


@wp.kernel
def _carry_kernel(active: Envs, m: FrameMotion, t: Trial):
    place, frame, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    if is_idle(frame, lane, m):
        return
    pose = frame_pose(env, frame, lane, m)
    for i in range(m.node_starts[frame] + lane, m.node_starts[frame + 1], m.lanes):
        node = m.nodes[i]
        put_node(env, node, carried(env, node, pose, m), t)


class FrameNodes:
    """The nodes that frames carry: vertices of kinematic bodies, bonded nodes of mounted gels."""

    def __init__(self, model: Model) -> None:
        self._model = model
        frames = model.frame_ids.numpy()
        counts = np.bincount(frames, minlength=len(model.kinematic))
        starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        nodes = model.frame_nodes.numpy()[np.argsort(frames, kind="stable")]
        self._nodes = wp.array(nodes, dtype=wp.int32, device=model.device)
        self._starts = wp.array(starts, dtype=wp.int32, device=model.device)
        self._most = int(counts.max(initial=0))

    def _launch(
        self,
        kernel: wp.Kernel,
        path: tuple[wp.array, wp.array],
        fractions: wp.array | None,
        poses: wp.array | None,
        inputs: Sequence[EnvMask],
        *rest: wp.array | Trial,
    ) -> None:
        model = self._model
        if not model.kinematic:
            return
        motion = FrameMotion()
        motion.nodes, motion.node_starts = self._nodes, self._starts
        motion.rest_positions = model.rest_positions
        motion.starts, motion.ends = path
        if fractions is not None and poses is not None:
            motion.fractions, motion.poses = fractions, poses
        motion.lanes = lane_count(model.device, place_count(inputs[0]), max(self._most, 1))
        dim = (model.env_count, len(model.kinematic), motion.lanes)
        launch(kernel, dim, *inputs, motion, *rest, device=model.device)

    def aim(
        self,
        active: EnvMask,
        moving: EnvMask,
        path: tuple[wp.array, wp.array],
        positions: wp.array,
        displacements: wp.array,
        fractions: wp.array | None = None,
        targets: wp.array | None = None,
    ) -> None:
        """Set ``displacements`` [m] of these nodes to what is left of their motion, in the
        environments of ``active``.

        ``moving`` flags the environments whose frames are still on their way along ``path`` (poses
        at its start and end, transformd, [env_count, kinematic_count]); elsewhere these nodes stay.
        They go to its end, or with ``fractions`` (float64, [env_count]) that part of it, to poses
        that are written to ``targets``.
        """
        masks = (active, moving)
        self._launch(_aim_nodes_kernel, path, fractions, targets, masks, positions, displacements)

    def place(
        self,
        active: EnvMask,
        trial: Trial,
        path: tuple[wp.array, wp.array],
        fractions: wp.array,
        poses: wp.array,
    ) -> None:
        """Put them where they are at the part ``fractions`` of ``path``, and write the ``poses``
        there; see ``aim``."""
        self._launch(_carry_kernel, path, fractions, poses, (active,), trial)
