# SPDX-License-Identifier: Apache-2.0
"""Broad phase: which pairs may come within a margin while all nodes move along straight lines.

Each kind of body has its own search (``stiff_targets``, ``soft_targets``, ``ball_targets``); planes
need none, as each node is checked. What is searched against what is the model's contact plan, so a
pair of bodies that can never touch costs nothing. ``margin`` must include how far the arc of a
turning kinematic body leaves the chord.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.ball_targets import BALL_JOBS
from taccel_lab.ipc.broad_phase.soft_targets import SoftTrees
from taccel_lab.ipc.broad_phase.stiff_targets import run_search, searches, update_frames
from taccel_lab.ipc.broad_phase.swept_box import Frames
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@dataclass
class PairList:
    """Pairs of primitives per environment; grows when it overflows."""

    counts: wp.array
    """int32, shape [env_count]."""
    pairs: wp.array
    """vec2i, shape [env_count, capacity]."""
    most: int = 0
    """Largest count."""

    def begin(self) -> None:
        """Empty the list."""
        self.counts.zero_()

    def grew(self, limit: int, overflowed: np.ndarray) -> bool:
        """Read the counts; when there was no room for all make it, and say so.

        Environments with more than ``limit`` pairs are emptied and marked in ``overflowed``.
        """
        counts = self.counts.numpy()
        if (counts > limit).any():
            overflowed |= counts > limit
            counts = np.where(counts > limit, 0, counts)
            self.counts.assign(counts)
        self.most = int(counts.max())
        if self.most <= self.pairs.shape[1]:
            return False
        shape = (self.pairs.shape[0], min(3 * self.most // 2, limit))
        self.pairs = wp.zeros(shape, dtype=wp.vec2i, device=self.pairs.device)
        return True


class Candidates:
    """Candidate pairs per environment."""

    def __init__(self, model: Model, capacity: int = 4096, limit: int = 1 << 20) -> None:
        self.model = model
        self.limit = limit
        """Pairs of one kind beyond which an environment is given up."""
        self.overflowed = np.zeros(model.env_count, dtype=bool)
        """Environments given up by the last update: their lists are empty, not right."""
        plan = model.plan

        def pair_list(needed: bool) -> PairList:
            shape = (model.env_count, capacity if needed else 1)
            return PairList(
                wp.zeros(model.env_count, dtype=wp.int32, device=model.device),
                wp.zeros(shape, dtype=wp.vec2i, device=model.device),
            )

        soft = plan.soft_to_soft
        faces = len(plan.node_target) + len(plan.face_target) + len(plan.ball_face)
        self._node_face = pair_list(faces > 0 or soft)
        self._edge_edge = pair_list(len(plan.edge_target) > 0 or soft)
        self._soft = SoftTrees(model) if soft else None
        self._needs_frames = faces > len(plan.ball_face) or len(plan.edge_target) > 0
        self._searches = searches(model)
        self._start, self._end = self._frames(), self._frames()
        self._rest = wp.zeros(
            (model.env_count, model.node_count), dtype=wp.vec3d, device=model.device
        )

    def _frames(self) -> Frames:
        frames = Frames()
        shape, device = (self.model.env_count, len(self.model.targets)), self.model.device
        frames.inverses = wp.zeros(shape, dtype=wp.mat33d, device=device)
        frames.origins = wp.zeros(shape, dtype=wp.vec3d, device=device)
        return frames

    @property
    def node_face(self) -> wp.array:
        """(node, face) pairs, vec2i, shape [env_count, capacity]."""
        return self._node_face.pairs

    @property
    def node_face_counts(self) -> wp.array:
        return self._node_face.counts

    @property
    def max_node_face(self) -> int:
        return self._node_face.most

    @property
    def edge_edge(self) -> wp.array:
        """(edge, edge) pairs, vec2i, shape [env_count, capacity]."""
        return self._edge_edge.pairs

    @property
    def edge_edge_counts(self) -> wp.array:
        return self._edge_edge.counts

    @property
    def max_edge_edge(self) -> int:
        return self._edge_edge.most

    def update(
        self,
        active: wp.array,
        positions: wp.array,
        displacements: wp.array,
        poses_start: wp.array,
        poses_end: wp.array,
        margin: float,
    ) -> None:
        """Find all pairs whose surfaces may come within ``margin`` [m] on the way.

        The way is from ``positions`` straight to positions + ``displacements``, of all nodes. A
        thickness of the bodies comes on top of the margin.
        """
        lists = (self._node_face, self._edge_edge)
        reach = margin + self.model.largest_thickness_m
        if self._needs_frames:
            update_frames(self.model, poses_start, positions, self._rest, self._start)
            update_frames(self.model, poses_end, positions, displacements, self._end)
        self.overflowed = np.zeros(self.model.env_count, dtype=bool)
        while True:
            for pair_list in lists:
                pair_list.begin()
            self._search(active, positions, displacements, reach)
            grown = [part.grew(self.limit, self.overflowed) for part in lists]
            if not any(grown):
                return

    def _search(
        self, active: wp.array, positions: wp.array, displacements: wp.array, margin: float
    ) -> None:
        model, surface = self.model, self.model.surface
        node_face = [self._node_face.counts, self._node_face.pairs]
        edge_edge = [self._edge_edge.counts, self._edge_edge.pairs]
        path, frames = [margin, positions, displacements], [self._start, self._end]
        for name, outputs in (("node", node_face), ("face", node_face), ("edge", edge_edge)):
            run_search(self._searches[name], model, active, path, frames, outputs)
        balls = model.plan.ball_face
        if len(balls):
            wp.launch(
                BALL_JOBS,
                dim=(model.env_count, len(balls)),
                inputs=[active, balls, surface.node_bodies, surface.node_radii, model.present]
                + [surface.faces, *path],
                outputs=node_face,
                device=model.device,
            )
        if self._soft is not None:
            self._soft.search(active, positions, displacements, margin, node_face, edge_edge)
