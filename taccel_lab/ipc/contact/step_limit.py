# SPDX-License-Identifier: Apache-2.0
"""The largest collision-free fraction of a displacement, per environment (additive CCD).

All pairs of an environment share the limit: one that stays apart up to the least fraction found so
far needs no more of its own.
"""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates, PairList
from taccel_lab.ipc.contact.collision_lists import (
    PAIR_THREADS,
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
from taccel_lab.model.env_lists import EnvMask, Envs, env_at, place_count
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "block_dim": PAIR_THREADS})


SLACKNESS = 0.1
"""Part of a gap that the longest step leaves. The barrier of a thin gap takes iterations to push
it open: with 0.3 squeezes and hands take 9 % fewer of Newton. But steps are cut more often: bolts
take 8 % more, presses up to 14 %, and pairs are searched for a fifth more often."""
_MOST_ADVANCES = 64
"""Advances of a pair, see ``ccd``. Of 12 million pairs of a peg one in 40,000 takes more, and a GPU
waits for the one that takes most: these stop early, at 0.8 of their fraction in the median."""


@wp.struct
class Way:
    """What all candidates go by.

    faces, edges: nodes of each; reaches_sq: see ``SurfaceArrays`` [m^2], [rest_count, face_count].
    positions, displacements [m], [env_count, node_count]; slackness, max_iterations: see
    ``limit_checks``.
    """

    faces: wp.array(dtype=wp.vec3i)
    edges: wp.array(dtype=wp.vec2i)
    reaches_sq: wp.array2d(dtype=wp.float64)
    positions: wp.array2d(dtype=wp.vec3d)
    displacements: wp.array2d(dtype=wp.vec3d)
    geometry: ContactGeometry
    slackness: wp.float64
    max_iterations: int


@wp.func
def node_face_limit(env: int, candidate: wp.vec2i, most: wp.float64, way: Way) -> wp.float64:
    """Collision-free fraction of a node against a face, up to ``most``.

    A curved face may reach into a ball (``ball_inset``), but its nodes may not.
    """
    p = candidate[0]
    f = way.faces[candidate[1]]
    if f[0] == p or f[1] == p or f[2] == p:
        return most
    x = way.positions[env]
    dx = way.displacements[env]
    kept = kept_distance(p, f[0], way.geometry)
    least = wp.float64(most)
    if way.geometry.node_is_ball[p] != 0:
        reach_sq = way.reaches_sq[env % way.reaches_sq.shape[0], candidate[1]]
        inset = ball_inset(way.geometry.node_radii[p], reach_sq)
        if inset > wp.float64(0.0):
            for k in range(3):
                slack = way.slackness
                least = point_point_ccd(x[p], x[f[k]], dx[p], dx[f[k]], kept, slack, least).toi
            kept -= inset
    result = point_triangle_ccd(
        x[p], x[f[0]], x[f[1]], x[f[2]], dx[p], dx[f[0]], dx[f[1]], dx[f[2]],
        kept, way.slackness, least, way.max_iterations,
    )  # fmt: skip
    return result.toi


@wp.func
def edge_edge_limit(env: int, candidate: wp.vec2i, most: wp.float64, way: Way) -> wp.float64:
    """Collision-free fraction of two edges, up to ``most``."""
    a = way.edges[candidate[0]]
    b = way.edges[candidate[1]]
    if a[0] == b[0] or a[0] == b[1] or a[1] == b[0] or a[1] == b[1]:
        return most
    x = way.positions[env]
    dx = way.displacements[env]
    kept = kept_distance(a[0], b[0], way.geometry)
    result = edge_edge_ccd(
        x[a[0]], x[a[1]], x[b[0]], x[b[1]], dx[a[0]], dx[a[1]], dx[b[0]], dx[b[1]],
        kept, way.slackness, most, way.max_iterations,
    )  # fmt: skip
    return result.toi


@wp.kernel
def _node_face_kernel(
    active: Envs,
    lanes: int,
    room: ListRoom,
    candidates: wp.array(dtype=wp.vec2i),
    way: Way,
    limits: wp.array(dtype=wp.float64),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(room.starts[env] + lane, list_end(env, room), lanes):
        most = limits[env]
        free = node_face_limit(env, candidates[at], most, way)
        if free < most:
            lower_to(limits, env, free)


@wp.kernel
def _edge_edge_kernel(
    active: Envs,
    lanes: int,
    room: ListRoom,
    candidates: wp.array(dtype=wp.vec2i),
    way: Way,
    limits: wp.array(dtype=wp.float64),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    for at in range(room.starts[env] + lane, list_end(env, room), lanes):
        most = limits[env]
        free = edge_edge_limit(env, candidates[at], most, way)
        if free < most:
            lower_to(limits, env, free)


@wp.kernel
def _node_plane_kernel(
    active: Envs,
    pairs: wp.array(dtype=wp.vec2i),
    present: wp.array2d(dtype=wp.int32),
    way: Way,
    limits: wp.array(dtype=wp.float64),
):
    place, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    p = pairs[i][0]
    plane = pairs[i][1]
    bodies = way.geometry.node_bodies
    if present[env, bodies[p]] == 0 or present[env, bodies[plane]] == 0:
        return
    x = way.positions[env]
    dx = way.displacements[env]
    normal = way.geometry.plane_normals[plane]
    kept = kept_distance(p, plane, way.geometry)
    most = limits[env]
    result = point_plane_ccd(x[p], x[plane], normal, dx[p], dx[plane], kept, way.slackness, most)
    lower_to(limits, env, result.toi)


def limit_checks(
    model: Model,
    active: EnvMask,
    candidates: Candidates,
    positions: wp.array,
    displacements: wp.array,
    limits: wp.array,
    slackness: float = SLACKNESS,
    max_iterations: int = _MOST_ADVANCES,
) -> list[Callable[[], None]]:
    """Launches, in any order or side by side, that lower ``limits`` [env_count] of active
    environments from what it is to the fraction of ``displacements`` that keeps all pairs apart.

    ``slackness``: part of the initial gap that is left at the limit. A query that needs more
    iterations than allowed stops early at a fraction that is still safe.
    """
    way, surface, planes = Way(), model.surface, model.contact_plan.node_plane
    way.faces, way.edges, way.reaches_sq = surface.faces, surface.edges, surface.face_reaches_sq
    way.positions, way.displacements = positions, displacements
    way.geometry = contact_geometry(model)
    way.slackness, way.max_iterations = slackness, max_iterations

    def against(kernel: wp.Kernel, pairs: PairList) -> None:
        lanes = lane_count(model.device, place_count(active), pairs.largest_room)
        inputs = [active, lanes, pairs.room, pairs.pairs, way, limits]
        launch(kernel, (model.env_count, lanes), *inputs)

    def of_planes() -> None:
        inputs = [active, planes, model.present, way, limits]
        launch(_node_plane_kernel, (model.env_count, len(planes)), *inputs)

    checks = []
    if candidates.node_faces.capacity:
        checks.append(lambda: against(_node_face_kernel, candidates.node_faces))
    if candidates.edge_edges.capacity:
        checks.append(lambda: against(_edge_edge_kernel, candidates.edge_edges))
    if len(planes):
        checks.append(of_planes)
    return checks
