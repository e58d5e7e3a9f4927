# SPDX-License-Identifier: Apache-2.0
"""Tractions of nodal forces on the deformed surface: force over the area around a node.

A node of a collision surface has a third of the area of each face around it, and as its normal the
mean of theirs by area. Pressure is the part of the traction against that normal, shear the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _traction_kernel(
    node_face_starts: wp.array(dtype=wp.int32),
    node_faces: wp.array(dtype=wp.int32),
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array2d(dtype=wp.vec3d),
    forces: wp.array2d(dtype=wp.vec3d),
    areas: wp.array2d(dtype=wp.float64),
    normals: wp.array2d(dtype=wp.vec3d),
    tractions: wp.array2d(dtype=wp.vec3d),
    pressures: wp.array2d(dtype=wp.float64),
):
    env, node = wp.tid()
    area = wp.float64(0.0)
    normal = wp.vec3d()
    for k in range(node_face_starts[node], node_face_starts[node + 1]):
        face = faces[node_faces[k]]
        a = positions[env, face[0]]
        doubled = wp.cross(positions[env, face[1]] - a, positions[env, face[2]] - a)
        normal += doubled
        area += wp.length(doubled) / wp.float64(6.0)
    areas[env, node] = area
    normals[env, node] = wp.normalize(normal)
    traction = wp.vec3d()
    if area > wp.float64(0.0):
        traction = forces[env, node] / area
    tractions[env, node] = traction
    pressures[env, node] = -wp.dot(traction, normals[env, node])


@dataclass(frozen=True)
class SurfaceLoad:
    """By node, shape [env_count, node_count]; zero where a node has no collision face."""

    areas: wp.array
    """Area that belongs to the node now [m^2], float64."""
    normals: wp.array
    """Unit outward normal, vec3d."""
    tractions: wp.array
    """Force per area [Pa], vec3d."""
    pressures: wp.array
    """Traction against the outward normal [Pa], float64; negative where it pulls."""


def surface_load(model: Model, positions: wp.array, forces: wp.array) -> SurfaceLoad:
    """Tractions of ``forces`` [N] at ``positions`` [m], vec3d, [env_count, node_count]."""
    s, shape, device = model.surface, positions.shape, model.device
    load = SurfaceLoad(
        areas=wp.zeros(shape, dtype=wp.float64, device=device),
        normals=wp.zeros(shape, dtype=wp.vec3d, device=device),
        tractions=wp.zeros(shape, dtype=wp.vec3d, device=device),
        pressures=wp.zeros(shape, dtype=wp.float64, device=device),
    )
    wp.launch(
        _traction_kernel,
        dim=shape,
        inputs=[s.node_face_starts, s.node_faces, s.faces, positions, forces],
        outputs=[load.areas, load.normals, load.tractions, load.pressures],
        device=device,
    )
    return load
