# SPDX-License-Identifier: Apache-2.0
"""Deformation of ten-node tets, straight at rest, and where they are kept from turning inside out.

F is linear in the element: with F_c the gradient at corner c and barycentric coordinates l of a
point, F = sum_c l_c F_c, and grad N of corner i is (4 l_i - 1) b_i, of the middle of edge ij
4 (l_j b_i + l_i b_j), where b_i are the gradients of the barycentric coordinates.

A tet may turn inside out between its quadrature points. A guard (``elasticity.volume_bounds``) acts
on the Bernstein coefficients of J, whose smallest one bounds J. It is silent in most tets, which
pay for the bound alone.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.volume_bounds import (
    GUARDED_RATIO,
    coefficient,
    coefficient_corners,
    least_coefficient,
    mixed_cofactor,
)
from taccel_lab.ipc.potentials.elements.data import ElementData

wp.set_module_options({"enable_backward": False})

OTHER = wp.constant(wp.float64((5.0 - 5.0**0.5) / 20.0))
"""Barycentric coordinate of quadrature point q at the corners other than q; at corner q it is
(5 + 3 sqrt(5)) / 20. The four points are exact for quadratic integrands [Zienkiewicz and Taylor
2000, table 9.2]."""
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


GUARD_WEIGHT = wp.constant(wp.float64(1.0 / 20.0))
"""Part of the volume that a coefficient stands for: the integral of its Bernstein polynomial."""


@wp.func
def needs_guard(env: int, tet: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData) -> bool:
    """Whether a Bernstein coefficient of J is below the guarded ratio, or not a number."""
    least = least_coefficient(
        corner_deformation(env, tet, 0, positions, d),
        corner_deformation(env, tet, 1, positions, d),
        corner_deformation(env, tet, 2, positions, d),
        corner_deformation(env, tet, 3, positions, d),
    )
    return not (least >= GUARDED_RATIO)


@wp.func
def needs_none(env: int, tet: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData) -> bool:
    """Tells that no guard is needed, for energies that bear inversion."""
    return False


@wp.func
def corner_gradients(env: int, tet: int, corner: int, turn: wp.mat33d, d: ElementData) -> mat103d:
    """Gradients as of ``shape_gradients``, at a corner."""
    return shape_gradients(env, tet, corner, wp.float64(0.0), wp.float64(1.0), turn, d)


@wp.func
def guard_coefficient(
    env: int, tet: int, q: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData
) -> wp.float64:
    """One of the twenty Bernstein coefficients of J."""
    c = coefficient_corners(q)
    return coefficient(
        corner_deformation(env, tet, c[0], positions, d),
        corner_deformation(env, tet, c[1], positions, d),
        corner_deformation(env, tet, c[2], positions, d),
    )


@wp.func
def guard_gradient(
    env: int, tet: int, q: int, positions: wp.array2d(dtype=wp.vec3d), d: ElementData
) -> mat103d:
    """Derivative of ``guard_coefficient`` by the nodes [1/m]."""
    c = coefficient_corners(q)
    f_0 = corner_deformation(env, tet, c[0], positions, d)
    f_1 = corner_deformation(env, tet, c[1], positions, d)
    f_2 = corner_deformation(env, tet, c[2], positions, d)
    sixth = wp.float64(1.0) / wp.float64(6.0)
    return (
        corner_gradients(env, tet, c[0], sixth * mixed_cofactor(f_1, f_2), d)
        + corner_gradients(env, tet, c[1], sixth * mixed_cofactor(f_0, f_2), d)
        + corner_gradients(env, tet, c[2], sixth * mixed_cofactor(f_0, f_1), d)
    )
