# SPDX-License-Identifier: Apache-2.0
"""Collision surfaces of all bodies on the device, search trees of stiff ones, plan of contact.

The plan says which primitives are searched against which body. A pair of bodies that can never
touch has no entry anywhere, so it costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import KinematicBody, Plane, SoftBody
from taccel_lab.bodies.primitives import Ball
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.bodies.surface_topology import SurfaceTopology

Put = Callable[[np.ndarray, Any], wp.array]
"""Copies a host array to the device as a Warp type."""


@dataclass
class SurfaceArrays:
    """Collision surfaces of all bodies (see SurfaceTopology)."""

    faces: wp.array
    edges: wp.array
    face_edges: wp.array
    edge_faces: wp.array
    node_face_starts: wp.array
    node_faces: wp.array
    node_edge_starts: wp.array
    node_edges: wp.array
    node_areas: wp.array
    """float64, shape [rest_count, node_count]."""
    edge_areas: wp.array
    """float64, shape [rest_count, edge_count]."""
    face_areas: wp.array
    """float64, shape [rest_count, face_count]."""
    face_reaches_sq: wp.array
    """Square of the radius of the smallest circle around a face of a quadratic element at rest
    [m^2], 0 for faces that are flat; float64, shape [rest_count, face_count]."""
    node_radii: wp.array
    """Distance that others keep from a node [m]: the radius of a ball, the thickness of a
    surface; float64, shape [node_count]."""
    node_is_ball: wp.array
    """1 for the centre of a ball, int32, shape [node_count]."""
    node_bodies: wp.array
    """Body id of a node, int32, shape [node_count]."""
    plane_normals: wp.array
    """Unit normal in the world at the origin node of a plane, zero elsewhere, vec3d,
    shape [node_count]."""


@dataclass
class SurfaceTrees:
    """Search trees over the faces, edges and vertices of a mesh in its own frame."""

    faces: wp.Bvh
    edges: wp.Bvh
    vertices: wp.Bvh


def surface_arrays(
    topology: SurfaceTopology,
    areas: tuple[np.ndarray, np.ndarray, np.ndarray],
    face_reaches_sq: np.ndarray,
    node_radii: np.ndarray,
    node_is_ball: np.ndarray,
    node_bodies: np.ndarray,
    plane_normals: np.ndarray,
    put: Put,
) -> SurfaceArrays:
    """Copy the collision surface to the device."""
    rows = {"faces": wp.vec3i, "edges": wp.vec2i, "face_edges": wp.vec3i, "edge_faces": wp.vec2i}
    return SurfaceArrays(
        **{name: put(value, rows.get(name, wp.int32)) for name, value in vars(topology).items()},
        node_areas=put(areas[0], wp.float64),
        edge_areas=put(areas[1], wp.float64),
        face_areas=put(areas[2], wp.float64),
        face_reaches_sq=put(face_reaches_sq, wp.float64),
        node_radii=put(node_radii, wp.float64),
        node_is_ball=put(node_is_ball, wp.int32),
        node_bodies=put(node_bodies, wp.int32),
        plane_normals=put(plane_normals, wp.vec3d),
    )


def _bvh(lower: np.ndarray, upper: np.ndarray, device: wp.Device) -> wp.Bvh:
    """A tree over FP32 boxes rounded outwards, so that no FP64 primitive leaves its box."""
    low = np.nextafter(lower.astype(np.float32), np.float32(-np.inf))
    high = np.nextafter(upper.astype(np.float32), np.float32(np.inf))
    return wp.Bvh(
        wp.array(low, dtype=wp.vec3, device=device), wp.array(high, dtype=wp.vec3, device=device)
    )


def surface_trees(
    vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray, device: wp.Device
) -> SurfaceTrees:
    """Trees of a mesh whose vertices, faces and edges count from zero."""
    corners, ends = vertices[faces], vertices[edges]
    return SurfaceTrees(
        faces=_bvh(corners.min(1), corners.max(1), device),
        edges=_bvh(ends.min(1), ends.max(1), device),
        vertices=_bvh(vertices, vertices, device),
    )


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
