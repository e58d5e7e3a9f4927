# SPDX-License-Identifier: Apache-2.0
"""Where a ten-node tet is kept from turning inside out.

It may do so near a corner or along an edge while all its quadrature points are in order. A guard on
the volume ratio (``elasticity.corner_guard``) stands at the corners and at points of the edges. It
is zero above a ratio that few elements come below: these are told by a bound of J over the element
(``elasticity.volume_bounds``), and the others pay for that only.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.corner_guard import GUARDED_RATIO
from taccel_lab.ipc.elasticity.volume_bounds import least_coefficient
from taccel_lab.ipc.potentials.element_data import ElementData
from taccel_lab.ipc.potentials.quadratic_shape import (
    EDGE_ENDS,
    EDGE_STARTS,
    corner_deformation,
    mat103d,
    shape_gradients,
)

wp.set_module_options({"enable_backward": False})

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
