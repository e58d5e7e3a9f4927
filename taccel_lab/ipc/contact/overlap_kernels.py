# SPDX-License-Identifier: Apache-2.0
"""Kernels of the search for overlaps: an edge, a node of a part, a ball or a plane a thread."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.contact.collision_lists import ball_inset
from taccel_lab.ipc.device.sums import BLOCK_THREADS, block_total
from taccel_lab.ipc.distance.closest_pairs import point_triangle_distance_sq

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})

_ROUNDING = wp.constant(wp.float64(64.0 * np.finfo(np.float64).eps))


@wp.struct
class Surfaces:
    """What the search knows of the bodies.

    edges, faces: nodes of each; body_faces: range of each body's faces, [body_count]; node_bodies:
    body of each node; present: 1 where a body is, [env_count, body_count]; lower, upper: corners of
    a box around each body where it is [m], [env_count, body_count]; pair_ids: number of each pair
    of bodies that may touch, [body_count, body_count].
    """

    edges: wp.array(dtype=wp.vec2i)
    faces: wp.array(dtype=wp.vec3i)
    body_faces: wp.array(dtype=wp.vec2i)
    node_bodies: wp.array(dtype=wp.int32)
    present: wp.array2d(dtype=wp.int32)
    lower: wp.array2d(dtype=wp.vec3d)
    upper: wp.array2d(dtype=wp.vec3d)
    pair_ids: wp.array2d(dtype=wp.int32)


@wp.struct
class Findings:
    """What was found.

    envs: 1 where anything overlaps, [env_count]; jobs: of each pair of bodies that overlap a job
    that found it, counted from 1, otherwise 0, [env_count, pair_count].
    """

    envs: wp.array(dtype=wp.int32)
    jobs: wp.array2d(dtype=wp.int32)


@wp.func
def _note(env: int, first: int, second: int, job: int, bodies: Surfaces, found: Findings):
    found.envs[env] = 1
    wp.atomic_max(found.jobs, env, bodies.pair_ids[first, second], job + 1)


@wp.func
def _is_known(env: int, first: int, second: int, bodies: Surfaces, found: Findings) -> bool:
    """Whether two bodies are known to overlap, so that no other job has to look at them."""
    return found.jobs[env, bodies.pair_ids[first, second]] != 0


@wp.func
def are_present(env: int, first: int, second: int, bodies: Surfaces) -> bool:
    """Whether two bodies are in an environment."""
    return bodies.present[env, first] != 0 and bodies.present[env, second] != 0


@wp.func
def _clean(volume: wp.float64, noise: wp.float64) -> wp.float64:
    """Zero where rounding may have made it."""
    if wp.abs(volume) <= noise:
        return wp.float64(0.0)
    return volume


@wp.func
def segment_pierces(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> bool:
    """Whether the segment p q passes through or touches the triangle a b c, by the signs of tet
    volumes; see ``bodies.crossings``."""
    largest = wp.max(
        wp.max(wp.max(wp.abs(p)), wp.max(wp.abs(q))),
        wp.max(wp.max(wp.abs(a)), wp.max(wp.max(wp.abs(b)), wp.max(wp.abs(c)))),
    )
    q = q - p
    a = a - p
    b = b - p
    c = c - p
    reach = wp.max(
        wp.max(wp.abs(q)), wp.max(wp.max(wp.abs(a)), wp.max(wp.max(wp.abs(b)), wp.max(wp.abs(c))))
    )
    noise = _ROUNDING * largest * reach * reach
    zero = wp.float64(0.0)
    normal = wp.cross(b - a, c - a)
    above = _clean(wp.dot(normal, -a), noise)
    below = _clean(wp.dot(normal, q - a), noise)
    if above * below > zero or (above == zero and below == zero):
        return False
    first = _clean(wp.dot(wp.cross(q, a), b), noise)
    second = _clean(wp.dot(wp.cross(q, b), c), noise)
    third = _clean(wp.dot(wp.cross(q, c), a), noise)
    lowest = wp.min(first, wp.min(second, third))
    highest = wp.max(first, wp.max(second, third))
    return lowest >= zero or highest <= zero


@wp.func
def half_solid_angle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.float64:
    """Half of the solid angle of a triangle seen from p [van Oosterom and Strackee 1983, eq. 8]."""
    a = a - p
    b = b - p
    c = c - p
    x = wp.length(a)
    y = wp.length(b)
    z = wp.length(c)
    down = x * y * z + wp.dot(a, b) * z + wp.dot(b, c) * x + wp.dot(c, a) * y
    return wp.atan2(wp.dot(a, wp.cross(b, c)), down)


@wp.kernel
def begin_overlaps_kernel(
    mask: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    searched: wp.array(dtype=wp.int32),
):
    """Environments that are not finite are left to the step, which says so."""
    env, node = wp.tid()
    if mask[env] == 0 or not wp.isfinite(positions[env, node]):
        searched[env] = 0


@wp.kernel
def crossing_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    first_job: int,
    found: Findings,
):
    """An edge against all faces of another body, or of its own."""
    env, i = wp.tid()
    edge = bodies.edges[jobs[i][0]]
    other = jobs[i][1]
    own = bodies.node_bodies[edge[0]]
    if searched[env] == 0 or _is_known(env, own, other, bodies, found):
        return
    if not are_present(env, own, other, bodies):
        return
    p = positions[env, edge[0]]
    q = positions[env, edge[1]]
    low = wp.min(p, q)
    high = wp.max(p, q)
    zero = wp.float64(0.0)
    if wp.max(wp.max(low - bodies.upper[env, other], bodies.lower[env, other] - high)) > zero:
        return
    for face in range(bodies.body_faces[other][0], bodies.body_faces[other][1]):
        nodes = bodies.faces[face]
        shared = own == other and (
            nodes[0] == edge[0]
            or nodes[1] == edge[0]
            or nodes[2] == edge[0]
            or nodes[0] == edge[1]
            or nodes[1] == edge[1]
            or nodes[2] == edge[1]
        )
        a = positions[env, nodes[0]]
        b = positions[env, nodes[1]]
        c = positions[env, nodes[2]]
        apart = wp.max(wp.max(wp.min(a, wp.min(b, c)) - high, low - wp.max(a, wp.max(b, c))))
        if not shared and apart <= zero:
            if segment_pierces(p, q, a, b, c):
                _note(env, own, other, first_job + i, bodies, found)
                return


@wp.kernel
def inside_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    first_job: int,
    found: Findings,
):
    """One node of a part of a surface against all of another surface, by a thread block."""
    env, i, lane = wp.tid()
    node = jobs[i][0]
    own = bodies.node_bodies[node]
    other = jobs[i][1]
    if searched[env] == 0 or not are_present(env, own, other, bodies):
        return
    p = positions[env, node]
    if wp.max(wp.max(p - bodies.upper[env, other], bodies.lower[env, other] - p)) > wp.float64(0.0):
        return
    half = wp.float64(0.0)
    for face in range(
        bodies.body_faces[other][0] + lane, bodies.body_faces[other][1], wp.block_dim()
    ):
        nodes = bodies.faces[face]
        a = positions[env, nodes[0]]
        b = positions[env, nodes[1]]
        c = positions[env, nodes[2]]
        half += half_solid_angle(p, a, b, c)
    total = block_total(half)
    # Once around is two pi of the half angles.
    if lane == 0 and wp.abs(total) > wp.float64(wp.pi):
        _note(env, own, other, first_job + i, bodies, found)


@wp.kernel
def ball_overlaps_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    face_reaches_sq: wp.array2d(dtype=wp.float64),
    radii: wp.array(dtype=wp.float64),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    first_job: int,
    found: Findings,
):
    """A ball against a face: curved faces may reach in by their inset, nodes may not."""
    env, i = wp.tid()
    ball = jobs[i][0]
    face = jobs[i][1]
    nodes = bodies.faces[face]
    own = bodies.node_bodies[ball]
    other = bodies.node_bodies[nodes[0]]
    if searched[env] == 0 or _is_known(env, own, other, bodies, found):
        return
    if not are_present(env, own, other, bodies):
        return
    centre = positions[env, ball]
    radius = radii[i]
    a = positions[env, nodes[0]]
    b = positions[env, nodes[1]]
    c = positions[env, nodes[2]]
    nearest = wp.min(
        wp.length_sq(a - centre), wp.min(wp.length_sq(b - centre), wp.length_sq(c - centre))
    )
    kept = radius - ball_inset(radius, face_reaches_sq[env % face_reaches_sq.shape[0], face])
    if nearest <= radius * radius or point_triangle_distance_sq(centre, a, b, c) <= kept * kept:
        _note(env, own, other, first_job + i, bodies, found)


@wp.kernel
def below_plane_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    plane_normals: wp.array(dtype=wp.vec3d),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    first_job: int,
    found: Findings,
):
    """A node below a plane or on it."""
    env, i = wp.tid()
    node = jobs[i][0]
    plane = jobs[i][1]
    own = bodies.node_bodies[node]
    other = bodies.node_bodies[plane]
    if searched[env] == 0 or not are_present(env, own, other, bodies):
        return
    height = wp.dot(positions[env, node] - positions[env, plane], plane_normals[plane])
    if not (height > wp.float64(0.0)):
        _note(env, own, other, first_job + i, bodies, found)
