# SPDX-License-Identifier: Apache-2.0
"""Collision surfaces of all bodies on the device, and search trees of stiff ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

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
    return SurfaceArrays(
        faces=put(topology.faces, wp.vec3i),
        edges=put(topology.edges, wp.vec2i),
        face_edges=put(topology.face_edges, wp.vec3i),
        edge_faces=put(topology.edge_faces, wp.vec2i),
        node_face_starts=put(topology.node_face_starts, wp.int32),
        node_faces=put(topology.node_faces, wp.int32),
        node_edge_starts=put(topology.node_edge_starts, wp.int32),
        node_edges=put(topology.node_edges, wp.int32),
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
