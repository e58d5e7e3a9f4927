# SPDX-License-Identifier: Apache-2.0
"""Which primitives are searched for contact against which body: lists that the scene decides once.

A pair of bodies that can never touch has no entry anywhere, so it costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import KinematicBody, Plane, SoftBody
from taccel_lab.bodies.primitives import Ball
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.model.surface import Put


@dataclass
class ContactPlan:
    """Search jobs; each array is empty when the scene has no such pair."""

    node_target: wp.array
    """(node, frame): a node against the face tree of a stiff body, vec2i."""
    face_target: wp.array
    """(face, frame): a face against the vertex tree of a stiff body, vec2i."""
    edge_target: wp.array
    """(edge, frame): an edge against the edge tree of a stiff body, vec2i."""
    ball_face: wp.array
    """(ball node, face), vec2i."""
    node_plane: wp.array
    """(node, plane node), vec2i."""
    soft_nodes: wp.array
    """Surface nodes of soft bodies that may touch a soft body, int32."""
    soft_faces: wp.array
    """Faces of those bodies, int32."""
    soft_edges: wp.array
    """Edges of those bodies, int32."""
    may_touch: wp.array
    """1 where two soft bodies may touch, int32, shape [body_count, body_count]."""
    pairs: list[tuple[int, int]]
    """Pairs of body ids that may touch."""

    @property
    def soft_to_soft(self) -> bool:
        """Whether soft bodies are searched against each other or themselves."""
        return len(self.soft_nodes) > 0


@dataclass(frozen=True)
class BodySurface:
    """Collision primitives of one body, global numbers."""

    nodes: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    frame: int
    """Number of its frame, -1 for soft bodies and planes."""


def _against(primitives: np.ndarray, other: int) -> np.ndarray:
    return np.column_stack([primitives, np.full(len(primitives), other)])


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros((0, 2))


def contact_plan(scene: SceneDescription, surfaces: list[BodySurface], put: Put) -> ContactPlan:
    """Search jobs of all pairs of bodies that may touch.

    Of two stiff bodies the one with fewer faces is carried into the frame of the other; kinematic
    bodies are always the frame, as their surface need not be carried anywhere.
    """
    bodies = scene.bodies
    count = len(bodies)
    jobs: dict[str, list[np.ndarray]] = {
        "node": [],
        "face": [],
        "edge": [],
        "ball": [],
        "plane": [],
    }
    soft_pairs = np.zeros((count, count), dtype=np.int32)
    pairs = []
    for i in range(count):
        for j in range(i, count):
            mine = bodies[i]
            if i == j:
                searched = isinstance(mine, SoftBody) and mine.self_contact
            else:
                searched = scene.may_touch(mine, bodies[j])
            if not searched:
                continue
            pairs.append((i, j))
            a, b = surfaces[i], surfaces[j]
            # Bodies are ordered soft, affine, kinematic, planes: the second is the stiffer one.
            second = bodies[j]
            if isinstance(second, Plane):
                jobs["plane"].append(_against(a.nodes, int(b.nodes[0])))
            elif isinstance(second, SoftBody):
                soft_pairs[i, j] = soft_pairs[j, i] = 1
            elif isinstance(second, KinematicBody) and isinstance(second.shape, Ball):
                balls = _against(a.faces, int(b.nodes[0]))
                jobs["ball"].append(balls[:, ::-1])
            else:
                if not isinstance(second, KinematicBody) and a.frame >= 0:
                    a, b = (a, b) if len(a.faces) <= len(b.faces) else (b, a)
                jobs["node"].append(_against(a.nodes, b.frame))
                jobs["face"].append(_against(a.faces, b.frame))
                jobs["edge"].append(_against(a.edges, b.frame))
    soft = [surfaces[i] for i in range(count) if soft_pairs[i].any()]
    none = np.zeros(0)
    return ContactPlan(
        node_target=put(_joined(jobs["node"]), wp.vec2i),
        face_target=put(_joined(jobs["face"]), wp.vec2i),
        edge_target=put(_joined(jobs["edge"]), wp.vec2i),
        ball_face=put(_joined(jobs["ball"]), wp.vec2i),
        node_plane=put(_joined(jobs["plane"]), wp.vec2i),
        soft_nodes=put(np.concatenate([none, *(s.nodes for s in soft)]), wp.int32),
        soft_faces=put(np.concatenate([none, *(s.faces for s in soft)]), wp.int32),
        soft_edges=put(np.concatenate([none, *(s.edges for s in soft)]), wp.int32),
        may_touch=put(soft_pairs, wp.int32),
        pairs=pairs,
    )
