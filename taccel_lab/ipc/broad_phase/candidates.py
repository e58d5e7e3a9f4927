# SPDX-License-Identifier: Apache-2.0
"""Broad phase: which pairs may come within a margin while all nodes move along straight lines.

Each kind of body has its own search (``stiff_targets``, ``soft_targets``); one against a ball needs
no tree, only a bound of the distance of each face, and planes need none, as each node is checked.
What is searched against what is the model's contact plan, so a pair of bodies that can never touch
costs nothing. Margins must include how far the arc of a turning kinematic body leaves the chord.
"""

from __future__ import annotations

from typing import ClassVar

import warp as wp

from taccel_lab.ipc.broad_phase.boxes import append
from taccel_lab.ipc.broad_phase.soft_targets import SoftTrees
from taccel_lab.ipc.broad_phase.stiff_targets import (
    make_frames,
    run_search,
    stiff_search,
    update_frames,
)
from taccel_lab.ipc.device.ragged_lists import GrowingList, ListRoom, clear_all, initial_capacity
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _ball_face_kernel(
    active: Envs,
    jobs: wp.array(dtype=wp.vec2i),
    node_bodies: wp.array(dtype=wp.int32),
    node_radii: wp.array(dtype=wp.float64),
    present: wp.array2d(dtype=wp.int32),
    faces: wp.array(dtype=wp.vec3i),
    margins: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    room: ListRoom,
    pairs: wp.array(dtype=wp.vec2i),
):
    """A ball against a face: a box around the face's path as seen from the ball."""
    place, i = wp.tid()
    env = env_at(place, active)
    ball = jobs[i][0]
    face = faces[jobs[i][1]]
    if env < 0:
        return
    if present[env, node_bodies[ball]] == 0:
        return
    if present[env, node_bodies[face[0]]] == 0:
        return
    centre = positions[env, ball]
    shift = displacements[env, ball]
    big = wp.float64(1.0e30)
    low = wp.vec3d(big, big, big)
    high = -low
    for k in range(3):
        a = positions[env, face[k]] - centre
        b = a + displacements[env, face[k]] - shift
        low = wp.min(low, wp.min(a, b))
        high = wp.max(high, wp.max(a, b))
    gap_sq = wp.float64(0.0)
    for k in range(3):
        outside = wp.max(wp.max(low[k], -high[k]), wp.float64(0.0))
        gap_sq += outside * outside
    reach = node_radii[ball] + margins[env]
    if gap_sq < reach * reach:
        append(env, ball, jobs[i][1], room, pairs)


class PairList(GrowingList):
    """Pairs of primitives."""

    columns: ClassVar = {"pairs": wp.vec2i}
    pairs: wp.array
    """Pairs of all environments, vec2i, shape [capacity]."""


class Candidates:
    """Candidate pairs per environment."""

    def __init__(self, model: Model, room: int | None = None, limit: int = 1 << 20) -> None:
        """``room``, ``limit``: pairs of an environment that there is room for at first, and that
        there may be."""
        self.model = model
        plan, device, env_count = model.contact_plan, model.device, model.env_count
        soft = plan.soft_to_soft
        faces = len(plan.node_target) + len(plan.face_target) + len(plan.ball_face)
        at_first = initial_capacity(env_count) if room is None else room

        def pair_list(needed: bool) -> PairList:
            return PairList(env_count, device, at_first if needed else 0, limit)

        self.node_faces = pair_list(faces > 0 or soft)
        """(node, face) pairs."""
        self.edge_edges = pair_list(len(plan.edge_target) > 0 or soft)
        """(edge, edge) pairs."""
        self._soft = SoftTrees(model) if soft else None
        self._needs_frames = faces > len(plan.ball_face) or len(plan.edge_target) > 0
        self._stiff = stiff_search(model)
        self._frames = make_frames(model)
        self._reach = wp.zeros(env_count, dtype=wp.float64, device=device)

    @property
    def lists(self) -> list[GrowingList]:
        """What may be too short: both lists, and the trees among gels, if any."""
        lists: list[GrowingList] = [self.node_faces, self.edge_edges]
        return lists if self._soft is None else [*lists, self._soft]

    def update(
        self,
        active: EnvMask,
        positions: wp.array,
        displacements: wp.array,
        poses_start: wp.array,
        poses_end: wp.array,
        margin: float,
    ) -> None:
        """``search`` with one margin [m] for all, by a host that makes room where it is short.

        Environments with more pairs than there can be room for are left without any.
        """
        margins = wp.full(len(active), margin, dtype=wp.float64, device=active.device)
        while True:
            self.search(active, positions, displacements, poses_start, poses_end, margins)
            grown = [part.fit() for part in self.lists]
            if not any(grown):
                return

    def search(
        self,
        active: EnvMask,
        positions: wp.array,
        displacements: wp.array,
        poses_start: wp.array,
        poses_end: wp.array,
        margins: wp.array,
    ) -> None:
        """Find all pairs whose surfaces may come within ``margins`` [m], [env_count], on the way.

        The way is from ``positions`` straight to positions + ``displacements``, of all nodes. A
        thickness of the bodies comes on top of the margin. Lists of environments that are not
        active stay as they are.
        """
        if self._needs_frames:
            poses = [poses_start, poses_end]
            update_frames(self.model, active, poses, positions, displacements, self._frames)
        reach = margins
        if self.model.largest_thickness_m > 0:
            reach = self._reach
            launch(_widen_kernel, len(reach), margins, self.model.largest_thickness_m, reach)
        clear_all(active, [self.node_faces, self.edge_edges])
        self._search(active, positions, displacements, reach)

    def _search(
        self, active: EnvMask, positions: wp.array, displacements: wp.array, margins: wp.array
    ) -> None:
        model, surface = self.model, self.model.surface
        node_face = [self.node_faces.room, self.node_faces.pairs]
        edge_edge = [self.edge_edges.room, self.edge_edges.pairs]
        path = [margins, positions, displacements]
        run_search(self._stiff, model, active, path, self._frames, node_face + edge_edge)
        balls = model.contact_plan.ball_face
        if len(balls):
            inputs = [active, balls, surface.node_bodies, surface.node_radii, model.present]
            launch(
                _ball_face_kernel,
                (model.env_count, len(balls)),
                *inputs,
                surface.faces,
                *path,
                *node_face,
            )
        if self._soft is not None:
            self._soft.search(active, positions, displacements, margins, node_face, edge_edge)


@wp.kernel
def _widen_kernel(
    margins: wp.array(dtype=wp.float64), thickness: wp.float64, reach: wp.array(dtype=wp.float64)
):
    env = wp.tid()
    reach[env] = margins[env] + thickness
