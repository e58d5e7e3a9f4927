# SPDX-License-Identifier: Apache-2.0
"""Tractions of nodal contact forces on the deformed surface: force over the area that is touched.

A node has a third of each face around it. Of that it offers to a contact what it shows in the
direction the contact comes from: at a rim the side that is touched counts and not the one around
the corner, as in the area weights of the contact itself. Pressure is the part of the traction along
that direction, shear the rest.

On quadratic tets middles of edges carry 19 of 20 parts of a uniform load, so that force over area
of one node means nothing. There the traction t is linear on each whole face, by its corners c:

    t_c = (f_c + 1/2 sum_m f_m) / (a_c + 1/2 sum_m a_m)

over the middles m of the edges at c, with forces f and areas a of the nodes; the middle of an edge
has the mean of both ends. This is the projection of the load on the hat functions of the corners
with a lumped mass: sum a t is the resultant force to rounding, and pressures never turn negative.
A pressure that curves is blunted by the mean over the faces around a corner, which is of the second
order in their size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.geometry import QuadraticMesh
from taccel_lab.model import Model
from taccel_lab.model.launches import launch
from taccel_lab.scene import SoftBody

wp.set_module_options({"enable_backward": False})


@wp.struct
class Middles:
    """Middles of edges on the surface of quadratic tets.

    ends: the two corners of a middle, -1 for other nodes, [node_count].
    starts: CSR of a corner into ``nodes``, its middles, [node_count + 1].
    """

    ends: wp.array(dtype=wp.vec2i)
    starts: wp.array(dtype=wp.int32)
    nodes: wp.array(dtype=wp.int32)


@wp.kernel
def _gather_kernel(
    middles: Middles,
    values: wp.array2d(dtype=wp.vec3d),
    sums: wp.array2d(dtype=wp.vec3d),
):
    """A corner's own vector and half of those of its middles."""
    env, node = wp.tid()
    total = values[env, node]
    if middles.ends[node][0] >= 0:
        total = wp.vec3d()
    for k in range(middles.starts[node], middles.starts[node + 1]):
        total += wp.float64(0.5) * values[env, middles.nodes[k]]
    sums[env, node] = total


@wp.func
def facing_load(
    env: int, node: int, middles: Middles, normal_sums: wp.array2d(dtype=wp.vec3d)
) -> wp.vec3d:
    """Direction against the contact force at a node, zero where there is none."""
    ends = middles.ends[node]
    if ends[0] >= 0:
        return -wp.normalize(normal_sums[env, ends[0]] + normal_sums[env, ends[1]])
    return -wp.normalize(normal_sums[env, node])


@wp.kernel
def _area_kernel(
    node_face_starts: wp.array(dtype=wp.int32),
    node_faces: wp.array(dtype=wp.int32),
    faces: wp.array(dtype=wp.vec3i),
    middles: Middles,
    positions: wp.array2d(dtype=wp.vec3d),
    normal_sums: wp.array2d(dtype=wp.vec3d),
    areas: wp.array2d(dtype=wp.float64),
    normals: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    facing = facing_load(env, node, middles, normal_sums)
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


@wp.func
def corner_traction(
    env: int,
    corner: int,
    middles: Middles,
    loads: wp.array2d(dtype=wp.vec3d),
    areas: wp.array2d(dtype=wp.float64),
) -> wp.vec3d:
    """Gathered load over the area that it was gathered from."""
    area = areas[env, corner]
    for k in range(middles.starts[corner], middles.starts[corner + 1]):
        area += wp.float64(0.5) * areas[env, middles.nodes[k]]
    if area > wp.float64(0.0):
        return loads[env, corner] / area
    return wp.vec3d()


@wp.kernel
def _traction_kernel(
    middles: Middles,
    normal_sums: wp.array2d(dtype=wp.vec3d),
    friction_sums: wp.array2d(dtype=wp.vec3d),
    areas: wp.array2d(dtype=wp.float64),
    tractions: wp.array2d(dtype=wp.vec3d),
    pressures: wp.array2d(dtype=wp.float64),
):
    env, node = wp.tid()
    first = middles.ends[node][0]
    second = middles.ends[node][1]
    if first < 0:
        first = node
        second = node
    normal = corner_traction(env, first, middles, normal_sums, areas)
    friction = corner_traction(env, first, middles, friction_sums, areas)
    if second != first:
        half = wp.float64(0.5)
        normal = half * (normal + corner_traction(env, second, middles, normal_sums, areas))
        friction = half * (friction + corner_traction(env, second, middles, friction_sums, areas))
    traction = normal + friction
    tractions[env, node] = traction
    pressures[env, node] = wp.dot(traction, wp.normalize(normal))


@dataclass(frozen=True)
class SurfaceLoad:
    """Load by node, shape [env_count, node_count]; zero where a node has no collision face.

    The sum of areas times tractions is the force on the surface, to rounding.
    """

    areas: wp.array
    """Area of the node now [m^2], float64: what faces the contact, or all where there is none."""
    normals: wp.array
    """Unit outward normal, the mean of the faces around by area, vec3d."""
    tractions: wp.array
    """Force per area [Pa], vec3d; on quadratic tets linear on each face with its three corners."""
    pressures: wp.array
    """Contact pressure [Pa], float64: the part of the traction along the contact force."""

    @classmethod
    def empty(cls, model: Model) -> SurfaceLoad:
        """Memory of a model's size."""
        shape, device = (model.env_count, model.node_count), model.device
        return cls(
            areas=wp.empty(shape, dtype=wp.float64, device=device),
            normals=wp.empty(shape, dtype=wp.vec3d, device=device),
            tractions=wp.empty(shape, dtype=wp.vec3d, device=device),
            pressures=wp.empty(shape, dtype=wp.float64, device=device),
        )


class SurfaceLoadReader:
    """Reads surface loads of a model's states."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.middles = middles_of(model)
        self._sums: list[wp.array] = []

    def read(
        self,
        positions: wp.array,
        normal_forces: wp.array,
        friction_forces: wp.array,
        into: SurfaceLoad | None = None,
    ) -> SurfaceLoad:
        """Tractions of contact forces [N] at ``positions`` [m], all vec3d, [env_count, node_count];
        written to ``into`` if that is given.

        Forces on nodes that show no area in their direction have no traction.
        """
        s, shape, device = self.model.surface, positions.shape, self.model.device
        load = SurfaceLoad.empty(self.model) if into is None else into
        if not self._sums:
            self._sums = [wp.empty(shape, dtype=wp.vec3d, device=device) for _ in range(2)]
        sums = self._sums
        for values, result in zip((normal_forces, friction_forces), sums, strict=True):
            launch(_gather_kernel, shape, self.middles, values, result)
        inputs = [s.node_face_starts, s.node_faces, s.faces, self.middles, positions, sums[0]]
        launch(_area_kernel, shape, *inputs, load.areas, load.normals)
        launch(
            _traction_kernel, shape, self.middles, *sums, load.areas, load.tractions, load.pressures
        )
        return load


def middles_of(model: Model) -> Middles:
    """Ends of the middles on the surfaces of all quadratic bodies, and the middles of corners."""
    ends = np.full((model.node_count, 2), -1, dtype=np.int32)
    for body, placed in zip(model.scene.bodies, model.bodies, strict=True):
        mesh = body.nodal_mesh if isinstance(body, SoftBody) else None
        if isinstance(mesh, QuadraticMesh):
            on_surface = np.unique(mesh.faces)
            middles = on_surface[on_surface >= mesh.base.node_count]
            first = placed.nodes[0]
            ends[first + middles] = first + mesh.edges[middles - mesh.base.node_count]
    nodes = np.flatnonzero(ends[:, 0] >= 0)
    corners = ends[nodes].ravel()
    order = np.argsort(corners, kind="stable")
    result = Middles()
    result.ends = wp.array(ends, dtype=wp.vec2i, device=model.device)
    starts = np.searchsorted(corners[order], np.arange(model.node_count + 1)).astype(np.int32)
    result.starts = wp.array(starts, dtype=wp.int32, device=model.device)
    of_corners = np.repeat(nodes, 2)[order].astype(np.int32)
    result.nodes = wp.array(of_corners, dtype=wp.int32, device=model.device)
    return result
