# SPDX-License-Identifier: Apache-2.0
"""Forces of contact and friction, put together anew in numpy from the pairs that are in contact.

Which pairs those are, and their share of the surface, is what the solver lists (``tests/ipc`` hold
the list against sums over all primitives with ipctk's distances); closest points, barrier,
mollifier and Coulomb's law are computed here, after Li et al. 2020 (Incremental Potential Contact,
sections 4.3 and 5) and Li, Kaufman and Jiang 2023.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.benchmarks.stress.gaps import closest_on_edges, part_along
from taccel_lab.ipc.contact.collision_lists import (
    EDGE_EDGE,
    POINT_EDGE,
    POINT_PLANE,
    POINT_TRIANGLE,
)
from taccel_lab.ipc.potentials.friction import FrozenContacts
from taccel_lab.model import Model
from taccel_lab.model.embedding import rotate

Array = np.ndarray


@dataclass(frozen=True)
class PairForces:
    """What the pairs of one environment do."""

    on_nodes: Array
    """Force on each node [N], [node_count, 3]."""
    of_pairs: Array
    """Normal force of each pair, or what friction can be at most [N]; negative where it takes back
    what was counted twice."""


@dataclass(frozen=True)
class SurfaceMotion:
    """How far everything has moved in a step."""

    moved_m: Array
    """Motion of each node [m], [node_count, 3]."""
    poses_before: Array
    """Poses of the kinematic bodies at the start, [kinematic_count, 7]."""
    poses: Array


def contact_forces(pairs: dict[str, Array], x: Array, model: Model) -> PairForces:
    """Forces of the pairs (``Collisions.snapshot``) at ``x`` [m], [node_count, 3]."""
    nodes, kinds = pairs["stencils"], pairs["kinds"]
    bodies = model.surface.node_bodies.numpy()
    radii = model.surface.node_radii.numpy()
    corners = x[nodes]
    weights = _closest_weights(kinds, corners)
    offset = np.einsum("pi,pij->pj", weights, corners - corners[:, :1])
    plane = kinds == POINT_PLANE
    up = model.surface.plane_normals.numpy()[nodes[plane, 1]]
    offset[plane] = np.einsum("pj,pj->p", offset[plane], up)[:, None] * up
    distance = np.linalg.norm(offset, axis=1)
    first, second = nodes[:, 0], nodes[:, 3]
    kept = np.where(bodies[first] == bodies[second], 0.0, radii[first] + radii[second])
    y = (distance - kept + pairs["insets"]) / pairs["ranges"]
    # A gap that is gone, which is another referee's affair, has no force.
    near = np.where(y > 0, np.minimum(y, 1.0), 1.0)
    log = np.log(near)
    slope = -pairs["stiffnesses"] * (near - 1) * (2 * log + (near - 1) / near)
    energy = -pairs["stiffnesses"] * pairs["ranges"] * (near - 1) ** 2 * log
    share, share_rate, cross_rate = _mollifier(kinds, corners, pairs["thresholds"])
    gradient = (share * slope / distance)[:, None, None] * weights[..., None] * offset[:, None]
    gradient += (energy * share_rate)[:, None, None] * cross_rate
    force = np.zeros_like(x)
    np.subtract.at(force, nodes, gradient)
    return PairForces(force, -share * slope)


def friction_forces(
    frozen: FrozenContacts, env: int, motion: SurfaceMotion, eps_m: float, model: Model
) -> PairForces:
    """Forces of the frozen pairs of an environment; ``eps_m``: sliding in the step below which
    friction is static [m]."""
    first = int(frozen.room.starts.numpy()[env])
    listed = slice(first, first + int(frozen.room.counts.numpy()[env]))
    nodes = frozen.stencils.numpy()[listed]
    weights = frozen.weights.numpy()[listed]
    normals = frozen.normals.numpy()[listed]
    limits = frozen.mu_lambdas.numpy()[listed]
    moved = motion.moved_m[nodes]
    u = np.einsum("pi,pij->pj", weights, moved) - frozen.normal_motions.numpy()[listed]
    u += _turned(nodes[:, 0], normals, motion, model)
    u -= np.einsum("pj,pj->p", u, normals)[:, None] * normals
    size = np.linalg.norm(u, axis=1)
    y = np.minimum(size / eps_m, 1.0)
    pull = (limits * y * (2 - y) / np.maximum(size, 1e-300))[:, None] * u
    force = np.zeros_like(motion.moved_m)
    np.subtract.at(force, nodes, weights[..., None] * pull[:, None])
    return PairForces(force, limits)


def friction_limits(pairs: dict[str, Array], pressing: Array, model: Model) -> Array:
    """Friction coefficient times normal force of each pair [N]."""
    bodies, coefficients = model.surface.node_bodies.numpy(), model.pair_friction.numpy()[0]
    nodes = pairs["stencils"]
    return coefficients[bodies[nodes[:, 0]], bodies[nodes[:, 3]]] * pressing


def _turned(nodes: Array, normals: Array, motion: SurfaceMotion, model: Model) -> Array:
    """What the surface of a ball, which is one node, moves by turning [m], [pair_count, 3]."""
    arms = np.zeros((len(nodes), 3))
    ball = model.surface.node_is_ball.numpy()[nodes] != 0
    if ball.any():
        first = len(model.scene.soft_bodies) + model.affine.count
        body = model.surface.node_bodies.numpy()[nodes[ball]] - first
        arm = -model.surface.node_radii.numpy()[nodes[ball], None] * normals[ball]
        back, now = (poses[body, 3:] for poses in (motion.poses_before, motion.poses))
        arms[ball] = arm - rotate(back, rotate(now * [-1, -1, -1, 1], arm))
    return arms


def _closest_weights(kinds: Array, corners: Array) -> Array:
    """Signed weights of the closest points on both primitives, [pair_count, 4]."""
    weights = np.zeros((len(kinds), 4))
    weights[:, 0] = 1.0
    a, b, c, d = (corners[:, k] for k in range(4))
    for kind, fill in ((POINT_TRIANGLE, _on_triangle), (POINT_EDGE, _on_edge)):
        of_kind = kinds == kind
        weights[of_kind, 1:] = -fill(*(p[of_kind] for p in (a, b, c, d)))
    edges = kinds == EDGE_EDGE
    s, t, _ = closest_on_edges(corners[edges, :2], corners[edges, 2:])
    weights[edges] = np.column_stack([1 - s, s, t - 1, -t])
    single = ~np.isin(kinds, (POINT_TRIANGLE, POINT_EDGE, EDGE_EDGE))
    weights[single, 1] = -1.0
    return weights


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("pj,pj->p", a, b)


def _on_edge(p: Array, a: Array, b: Array, _: Array) -> Array:
    """Weights (a, b, 0) of the point of the edge that is closest to p."""
    t = part_along(p - a, b - a)
    return np.column_stack([1 - t, t, np.zeros_like(t)])


def _on_triangle(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Weights (a, b, c) of the point of the triangle that is closest to p."""
    normal = np.cross(b - a, c - a)
    size = np.maximum(_dot(normal, normal), 1e-300)
    v = _dot(np.cross(p - a, c - a), normal) / size
    w = _dot(np.cross(b - a, p - a), normal) / size
    best = np.column_stack([1 - v - w, v, w])
    outside = (best < 0).any(axis=1)
    nearest = np.full(len(p), np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        ends = (a, b, c)[i], (a, b, c)[j]
        on_edge = _on_edge(p, *ends, p)
        off = p - on_edge[:, :1] * ends[0] - on_edge[:, 1:2] * ends[1]
        better = outside & (_dot(off, off) < nearest)
        nearest[better] = _dot(off, off)[better]
        best[better] = 0.0
        best[better, i], best[better, j] = on_edge[better, 0], on_edge[better, 1]
    return best


def _mollifier(kinds: Array, corners: Array, thresholds: Array) -> tuple[Array, Array, Array]:
    """Mollifier of each pair, its rate by |u x v|^2 [1/m^4], and the rate of that [m^3]."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 2]
    cross = np.cross(u, v)
    soft = (kinds == EDGE_EDGE) & (thresholds > 0)
    limit = np.where(soft, thresholds, 1.0)
    y = np.where(soft, np.minimum(_dot(cross, cross) / limit, 1.0), 1.0)
    by_u, by_v = 2 * np.cross(v, cross), 2 * np.cross(cross, u)
    rate = np.stack([-by_u, by_u, -by_v, by_v], axis=1)
    return y * (2 - y), 2 * (1 - y) / limit, rate
