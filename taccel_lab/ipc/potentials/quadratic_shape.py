# SPDX-License-Identifier: Apache-2.0
"""Deformation of ten-node tets with straight edges at rest, and gradients of their shape functions.

F is linear in the element: with F_c the gradient at corner c and barycentric coordinates l of a
point, F = sum_c l_c F_c, and grad N of corner i is (4 l_i - 1) b_i, of the middle of edge ij
4 (l_j b_i + l_i b_j), where b_i are the gradients of the barycentric coordinates.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.potentials.element_data import ElementData

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
