# SPDX-License-Identifier: Apache-2.0
"""Which surface of a pair measures the contact, how stiff its contact is, and how far a body keeps
from itself."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import SoftBody
from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.ipc.distance.point_triangle import point_triangle_distance_sq
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


STIFF_KAPPA_PA = 1e6
"""Contact stiffness of a scene without soft bodies."""


def body_kappas(model: Model, kappa: float | None) -> wp.array:
    """Contact stiffness that each body asks for, and in the last column that between bodies that
    ask for none [Pa], float64, shape [1 or env_count, body_count + 1].

    ``kappa`` where one is given; else Young's modulus of a soft body, 0 for the others, and between
    these the largest modulus of the scene. A gel is thus pressed the same whatever else is in the
    scene: with the largest modulus for all contacts, the layer in front of a soft gel beside one a
    million times as stiff was nearly dhat thick, which raised its force by 3 %. Where moduli differ
    by environment (``Model.set_body``), so does the stiffness: it is that of a model built with the
    environment's moduli.
    """
    if kappa is None and model.scene.soft_bodies:
        return model.largest_moduli
    shape = (1, len(model.bodies) + 1)
    value = STIFF_KAPPA_PA if kappa is None else kappa
    return wp.full(shape, value, dtype=wp.float64, device=model.device)


def body_ranks(model: Model) -> np.ndarray:
    """Rank of each body, int32, shape [body_count]: of two, the higher one measures the contact.

    Soft bodies rank above stiff ones, which all rank the same. Among soft bodies the finer mesh
    ranks higher, by the mean length of its surface edges; equal ones rank the same. The mesh of the
    scene decides, not the rest shape of any environment, so that they stay independent.
    """
    sizes = []
    for body in model.scene.bodies:
        if isinstance(body, SoftBody):
            mesh = body.nodal_mesh
            ends = mesh.nodes_m[unique_edges(mesh.faces)]
            size = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean()
            sizes.append(float(f"{size:.6g}"))
        else:
            sizes.append(np.inf)
    coarse_first = sorted({size for size in sizes if size < np.inf}, reverse=True)
    ranks = [1 + coarse_first.index(size) if size < np.inf else 0 for size in sizes]
    return np.array(ranks, dtype=np.int32)


@wp.kernel
def _self_range_kernel(
    bvh: wp.uint64,
    node_start: int,
    face_start: int,
    row: int,
    faces: wp.array(dtype=wp.vec3i),
    rest_positions: wp.array2d(dtype=wp.vec3d),
    ranges: wp.array2d(dtype=wp.float64),
):
    """Half of the rest distance to the nearest face that does not hold the node."""
    node = node_start + wp.tid()
    p = rest_positions[row, node]
    reach = wp.float64(2.0) * ranges[row, node]
    low = wp.vec3(p - wp.vec3d(reach, reach, reach))
    high = wp.vec3(p + wp.vec3d(reach, reach, reach))
    # The boxes are FP32: one rounding is at most 6e-8 of the value.
    slack = wp.float32(2.0e-7) * (wp.length(low) + wp.length(high))
    grow = wp.vec3(slack, slack, slack)
    query = wp.bvh_query_aabb(bvh, low - grow, high + grow)
    hit = int(0)
    nearest = reach * reach
    while wp.bvh_query_next(query, hit):
        face = faces[face_start + hit]
        if face[0] != node and face[1] != node and face[2] != node:
            distance_sq = point_triangle_distance_sq(
                p,
                rest_positions[row, face[0]],
                rest_positions[row, face[1]],
                rest_positions[row, face[2]],
            )
            nearest = wp.min(nearest, distance_sq)
    ranges[row, node] = wp.float64(0.5) * wp.sqrt(nearest)


def self_ranges(model: Model, dhat: float) -> wp.array:
    """Gap from which a node repels its own body [m], float64, shape [rest_count, node_count].

    The smaller of ``dhat`` and half of the distance to the rest of the surface at rest.
    """
    shape, device = (model.rest_count, model.node_count), model.device
    ranges = wp.full(shape, dhat, dtype=wp.float64, device=device)
    touching_itself = [a for a, b in model.contact_plan.pairs if a == b]
    if not touching_itself:
        return ranges
    rest = model.rest_positions.numpy()
    faces = model.surface.faces.numpy()
    for body in (model.bodies[i] for i in touching_itself):
        for row in range(model.rest_count):
            corners = rest[row, faces[slice(*body.faces)]]
            low = np.nextafter(corners.min(axis=1).astype(np.float32), np.float32(-np.inf))
            high = np.nextafter(corners.max(axis=1).astype(np.float32), np.float32(np.inf))
            tree = wp.Bvh(
                wp.array(low, dtype=wp.vec3, device=device),
                wp.array(high, dtype=wp.vec3, device=device),
            )
            wp.launch(
                _self_range_kernel,
                dim=body.nodes[1] - body.nodes[0],
                inputs=[tree.id, body.nodes[0], body.faces[0], row]
                + [model.surface.faces, model.rest_positions],
                outputs=[ranges],
                device=device,
            )
    return ranges
