# SPDX-License-Identifier: Apache-2.0
"""Deformation of ten-node tets, straight at rest, and where they are kept from turning inside out.

F is linear in the element: with F_c the gradient at corner c and barycentric coordinates l of a
point, F = sum_c l_c F_c, and grad N of corner i is (4 l_i - 1) b_i, of the middle of edge ij
4 (l_j b_i + l_i b_j), where b_i are the gradients of the barycentric coordinates.

A tet may turn inside out near a corner or along an edge while all its quadrature points are in
order. A guard on the volume ratio (``elasticity.volume_bounds``) stands at the corners and at
points of the edges. It is zero above a ratio that few elements come below. A bound of J over the
element (in the same place) finds these; the others pay for the bound alone.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.volume_bounds import GUARDED_RATIO, least_coefficient
from taccel_lab.ipc.potentials.elements.data import ElementData

wp.set_module_options({"enable_backward": False})

POINT_COUNT = 4
"""Quadrature points: point q has barycentric coordinate (5 + 3 sqrt(5)) / 20 at corner q and
(5 - sqrt(5)) / 20 at the others, exact for quadratic integrands [Zienkiewicz and Taylor 2000, table
9.2]."""
OTHER = wp.constant(wp.float64((5.0 - 5.0**0.5) / 20.0))
OWN_LESS_OTHER = wp.constant(wp.float64(5.0**0.5 / 5.0))

mat44i = wp.types.matrix(shape=(4, 4), dtype=wp.int32)
mat103d = wp.types.matrix(shape=(10, 3), dtype=wp.float64)

EDGE_STARTS = wp.constant(wp.types.vector(length=6, dtype=wp.int32)(0, 1, 0, 0, 1, 2))
EDGE_ENDS = wp.constant(wp.types.vector(length=6, dtype=wp.int32)(1, 2, 2, 3, 3, 3))
"""Corners of the edges, in the order of their middle nodes."""

MIDDLES = wp.constant(mat44i(0, 4, 6, 7, 4, 1, 5, 8, 6, 5, 2, 9, 7, 8, 9, 3))
"""Local node in the middle of the edge of two corners; a corner itself on the diagonal."""


@wp.func
def corner_deformation(
    env: int, tet: int, corner: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData
) -> wp.mat33d:
    """F at a corner."""
    rest = env % d.volumes.shape[0]
    four = wp.float64(4.0)
    x = positions[env, d.nodes[tet, corner]]
    f = wp.mat33d()
    for step in range(1, 4):
        j = (corner + step) % 4
        # Differences first: positions are large against an element.
        middle = positions[env, d.nodes[tet, MIDDLES[corner, j]]] - x
        end = positions[env, d.nodes[tet, j]] - x
        f += wp.outer(four * middle - end, d.gradients[rest, tet, j])
    return f


@wp.func
def common_deformation(
    env: int, tet: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData
) -> wp.mat33d:
    """What F has in common at all quadrature points: OTHER sum_c F_c."""
    total = wp.mat33d()
    corner = int(0)
    while corner < 4:
        total += corner_deformation(env, tet, corner, positions, d)
        corner += 1
    return OTHER * total


@wp.func
def point_deformation(
    env: int,
    tet: int,
    q: int,
    common: wp.mat33d,
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
) -> wp.mat33d:
    """F at a quadrature point."""
    return common + OWN_LESS_OTHER * corner_deformation(env, tet, q, positions, d)


@wp.func
def quadratic_deformation(
    env: int, tet: int, q: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData
) -> wp.mat33d:
    """F at one quadrature point alone."""
    common = common_deformation(env, tet, positions, d)
    return point_deformation(env, tet, q, common, positions, d)


@wp.func
def shape_gradients(
    env: int,
    tet: int,
    q: int,
    other: wp.float64,
    own_less_other: wp.float64,
    turn: wp.mat33d,
    d: ElementData,
) -> mat103d:
    """Rest gradients of the ten shape functions [1/m], rows turned by ``turn``, at the point on the
    way from the centre to corner q whose other barycentric coordinates are ``other``."""
    rest = env % d.volumes.shape[0]
    four = wp.float64(4.0)
    result = mat103d()
    for i in range(4):
        b_i = turn * d.gradients[rest, tet, i]
        l_i = wp.float64(other)
        if i == q:
            l_i += own_less_other
        for k in range(3):
            result[i, k] = (four * l_i - wp.float64(1.0)) * b_i[k]
        for j in range(i + 1, 4):
            l_j = wp.float64(other)
            if j == q:
                l_j += own_less_other
            b_j = turn * d.gradients[rest, tet, j]
            for k in range(3):
                result[MIDDLES[i, j], k] = four * (l_j * b_i[k] + l_i * b_j[k])
    return result


@wp.func
def row_of(m: mat103d, i: int) -> wp.vec3d:
    """Row i."""
    return wp.vec3d(m[i, 0], m[i, 1], m[i, 2])


GUARD_WEIGHT = wp.constant(wp.float64(1.0 / 40.0))
"""Part of the volume that a guarded point stands for: as in the cubic rule with corners [ibid.]."""
GUARDED = wp.constant(28)
"""Guarded points: the corners, and four of each edge. Sharp tools turn edges inside out beside a
corner or further along: J is cubic there."""
GUARDED_PARTS = wp.constant(wp.vec2d(1.0 / 6.0, 2.0 / 5.0))
"""Where they lie from either end, as parts of the edge: closer towards corners, where J falls."""


@wp.func
def needs_guard(env: int, tet: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData) -> bool:
    """Whether J may be below the guarded ratio anywhere; what is not a number needs it, too."""
    least = least_coefficient(
        corner_deformation(env, tet, 0, positions, d),
        corner_deformation(env, tet, 1, positions, d),
        corner_deformation(env, tet, 2, positions, d),
        corner_deformation(env, tet, 3, positions, d),
    )
    return not (least >= GUARDED_RATIO)


@wp.func
def needs_none(env: int, tet: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData) -> bool:
    """For energies that bear inversion."""
    return False


@wp.func
def guarded_ends(point: int):
    """Corners that a guarded point lies between, and how far it is from the first to the second as
    a part of the edge; a corner is both."""
    if point < 4:
        return point, point, wp.float64(0.0)
    edge = (point - 4) / 4
    part = GUARDED_PARTS[point % 2]
    if point % 4 < 2:
        return EDGE_STARTS[edge], EDGE_ENDS[edge], part
    return EDGE_ENDS[edge], EDGE_STARTS[edge], part


@wp.func
def guarded_deformation(
    env: int, tet: int, point: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData
) -> wp.mat33d:
    """F at a guarded point: F is linear."""
    near, far, part = guarded_ends(point)
    f = corner_deformation(env, tet, near, positions, d)
    if far != near:
        f += part * (corner_deformation(env, tet, far, positions, d) - f)
    return f


@wp.func
def guarded_gradients(env: int, tet: int, point: int, turn: wp.mat33d, d: ElementData) -> mat103d:
    """As ``shape_gradients``, at a guarded point."""
    none = wp.float64(0.0)
    one = wp.float64(1.0)
    near, far, part = guarded_ends(point)
    rows = shape_gradients(env, tet, near, none, one, turn, d)
    if far != near:
        rows += part * (shape_gradients(env, tet, far, none, one, turn, d) - rows)
    return rows
