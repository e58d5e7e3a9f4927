# SPDX-License-Identifier: Apache-2.0
"""The largest collision-free fraction of a displacement, per environment (additive CCD)."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates, PairList
from taccel_lab.ipc.contact.collision_lists import (
    ContactGeometry,
    ball_inset,
    contact_geometry,
    kept_distance,
)
from taccel_lab.ipc.device.ragged_lists import ListRoom, list_end
from taccel_lab.ipc.device.sums import lower_to
from taccel_lab.ipc.distance.ccd import (
    edge_edge_ccd,
    point_plane_ccd,
    point_point_ccd,
    point_triangle_ccd,
)
from taccel_lab.model import Model
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


@wp.func
def node_face_limit(
    env: int,
    candidate: wp.vec2i,
    faces: wp.array(dtype=wp.vec3i),
    reaches_sq: wp.array2d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    slackness: wp.float64,
    max_iterations: int,
) -> wp.float64:
    """Collision-free fraction of a node against a face.

    A curved face may reach into a ball (``ball_inset``), but its nodes may not.
    """
    p = candidate[0]
    f = faces[candidate[1]]
    if f[0] == p or f[1] == p or f[2] == p:
        return wp.float64(1.0)
    kept = kept_distance(p, f[0], geometry)
    least = wp.float64(1.0)
    if geometry.node_is_ball[p] != 0:
        reach_sq = reaches_sq[env % reaches_sq.shape[0], candidate[1]]
        inset = ball_inset(geometry.node_radii[p], reach_sq)
        if inset > wp.float64(0.0):
            for k in range(3):
                at_node = point_point_ccd(
                    positions[env, p],
                    positions[env, f[k]],
                    displacements[env, p],
                    displacements[env, f[k]],
                    kept,
                    slackness,
                    least,
                )
                least = at_node.toi
            kept -= inset
    result = point_triangle_ccd(
        positions[env, p],
        positions[env, f[0]],
        positions[env, f[1]],
        positions[env, f[2]],
        displacements[env, p],
        displacements[env, f[0]],
        displacements[env, f[1]],
        displacements[env, f[2]],
        kept,
        slackness,
        least,
        max_iterations,
    )
    return result.toi


@wp.func
def edge_edge_limit(
    env: int,
    candidate: wp.vec2i,
    edges: wp.array(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    slackness: wp.float64,
    max_iterations: int,
) -> wp.float64:
    """Collision-free fraction of two edges."""
    a = edges[candidate[0]]
    b = edges[candidate[1]]
    if a[0] == b[0] or a[0] == b[1] or a[1] == b[0] or a[1] == b[1]:
        return wp.float64(1.0)
    result = edge_edge_ccd(
        positions[env, a[0]],
        positions[env, a[1]],
        positions[env, b[0]],
        positions[env, b[1]],
        displacements[env, a[0]],
        displacements[env, a[1]],
        displacements[env, b[0]],
        displacements[env, b[1]],
        kept_distance(a[0], b[0], geometry),
        slackness,
        wp.float64(1.0),
        max_iterations,
    )
    return result.toi


@wp.kernel
def _node_face_kernel(
    active: wp.array(dtype=wp.int32),
    lanes: int,
    room: ListRoom,
    candidates: wp.array(dtype=wp.vec2i),
    faces: wp.array(dtype=wp.vec3i),
    reaches_sq: wp.array2d(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    slackness: wp.float64,
    max_iterations: int,
    limits: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    least = wp.float64(1.0)
    for at in range(room.starts[env] + lane, list_end(env, room), lanes):
        limit = node_face_limit(
            env,
            candidates[at],
            faces,
            reaches_sq,
            positions,
            displacements,
            geometry,
            slackness,
            max_iterations,
        )
        least = wp.min(least, limit)
    if least < wp.float64(1.0):
        lower_to(limits, env, least)


@wp.kernel
def _edge_edge_kernel(
    active: wp.array(dtype=wp.int32),
    lanes: int,
    room: ListRoom,
    candidates: wp.array(dtype=wp.vec2i),
    edges: wp.array(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    slackness: wp.float64,
    max_iterations: int,
    limits: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    least = wp.float64(1.0)
    for at in range(room.starts[env] + lane, list_end(env, room), lanes):
        limit = edge_edge_limit(
            env,
            candidates[at],
            edges,
            positions,
            displacements,
            geometry,
            slackness,
            max_iterations,
        )
        least = wp.min(least, limit)
    if least < wp.float64(1.0):
        lower_to(limits, env, least)


@wp.kernel
def _node_plane_kernel(
    active: wp.array(dtype=wp.int32),
    pairs: wp.array(dtype=wp.vec2i),
    present: wp.array2d(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
    slackness: wp.float64,
    limits: wp.array(dtype=wp.float64),
):
    env, i = wp.tid()
    if active[env] == 0:
        return
    p = pairs[i][0]
    plane = pairs[i][1]
    if present[env, geometry.node_bodies[p]] == 0 or present[env, geometry.node_bodies[plane]] == 0:
        return
    result = point_plane_ccd(
        positions[env, p],
        positions[env, plane],
        geometry.plane_normals[plane],
        displacements[env, p],
        displacements[env, plane],
        kept_distance(p, plane, geometry),
        slackness,
        wp.float64(1.0),
    )
    lower_to(limits, env, result.toi)


def limit_checks(
    model: Model,
    active: wp.array,
    candidates: Candidates,
    positions: wp.array,
    displacements: wp.array,
    limits: wp.array,
    slackness: float = 0.1,
    max_iterations: int = 1000,
) -> list[Callable[[], None]]:
    """Launches, in any order or side by side, that lower ``limits`` [env_count] of active
    environments from 1 to the fraction of ``displacements`` that keeps all pairs apart.

    ``slackness``: part of the initial gap that is left at the limit. A query that needs more
    iterations than allowed stops early at a fraction that is still safe.
    """
    geometry = contact_geometry(model)
    path = [positions, displacements, geometry, slackness]
    planes = model.contact_plan.node_plane

    def against(kernel: wp.Kernel, pairs: PairList, primitives: list[wp.array]) -> None:
        lanes = lane_count(model.device, model.env_count, pairs.largest_room)
        inputs = [active, lanes, pairs.room, pairs.pairs, *primitives, *path, max_iterations]
        launch(kernel, (model.env_count, lanes), *inputs, limits)

    def of_faces() -> None:
        primitives = [model.surface.faces, model.surface.face_reaches_sq]
        against(_node_face_kernel, candidates.node_faces, primitives)

    def of_edges() -> None:
        against(_edge_edge_kernel, candidates.edge_edges, [model.surface.edges])

    def of_planes() -> None:
        inputs = [active, planes, model.present, *path, limits]
        launch(_node_plane_kernel, (model.env_count, len(planes)), *inputs)

    checks = []
    if candidates.node_faces.capacity:
        checks.append(of_faces)
    if candidates.edge_edges.capacity:
        checks.append(of_edges)
    if len(planes):
        checks.append(of_planes)
    return checks
