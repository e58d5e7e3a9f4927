# SPDX-License-Identifier: Apache-2.0
"""Tractions of nodal contact forces on the deformed surface: force over the area that is touched.

A node has a third of each face around it. Of that it offers to a contact what it shows in the
direction the contact comes from: at a rim the side that is touched counts and not the one around
the corner, as in the area weights of the contact itself. Pressure is the part of the traction along
that direction, shear the rest.
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
    normal_forces: wp.array2d(dtype=wp.vec3d),
    friction_forces: wp.array2d(dtype=wp.vec3d),
    areas: wp.array2d(dtype=wp.float64),
    normals: wp.array2d(dtype=wp.vec3d),
    tractions: wp.array2d(dtype=wp.vec3d),
    pressures: wp.array2d(dtype=wp.float64),
):
    env, node = wp.tid()
    facing = -wp.normalize(normal_forces[env, node])
    is_loaded = wp.length_sq(facing) > wp.float64(0.0)
    area = wp.float64(0.0)
    normal = wp.vec3d()
    for k in range(node_face_starts[node], node_face_starts[node + 1]):
        face = faces[node_faces[k]]
        a = positions[env, face[0]]
        share = wp.cross(positions[env, face[1]] - a, positions[env, face[2]] - a)
        share = share / wp.float64(6.0)
        normal += share
        if is_loaded:
            area += wp.max(wp.dot(share, facing), wp.float64(0.0))
        else:
            area += wp.length(share)
    areas[env, node] = area
    normals[env, node] = wp.normalize(normal)
    traction = wp.vec3d()
    if area > wp.float64(0.0):
        traction = (normal_forces[env, node] + friction_forces[env, node]) / area
    tractions[env, node] = traction
    pressures[env, node] = -wp.dot(traction, facing)


@dataclass(frozen=True)
class SurfaceLoad:
    """By node, shape [env_count, node_count]; zero where a node has no collision face."""

    areas: wp.array
    """Area of the node now [m^2], float64: what faces the contact, or all where there is none."""
    normals: wp.array
    """Unit outward normal, the mean of the faces around by area, vec3d."""
    tractions: wp.array
    """Force per area [Pa], vec3d."""
    pressures: wp.array
    """Contact pressure [Pa], float64. On quadratic tets it alternates between corners and middles
    of edges, as their shares in the load of a face do: sums of forces are right, these are not."""


def surface_load(
    model: Model, positions: wp.array, normal_forces: wp.array, friction_forces: wp.array
) -> SurfaceLoad:
    """Tractions of contact forces [N] at ``positions`` [m], all vec3d, [env_count, node_count]."""
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
        inputs=[s.node_face_starts, s.node_faces, s.faces, positions]
        + [normal_forces, friction_forces],
        outputs=[load.areas, load.normals, load.tractions, load.pressures],
        device=device,
    )
    return load
