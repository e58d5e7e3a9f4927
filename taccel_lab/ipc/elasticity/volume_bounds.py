# SPDX-License-Identifier: Apache-2.0
"""What keeps a curved tet from turning inside out: bounds of J, and a guard on them.

Does a curved tet turn inside out anywhere? Bounds of the volume ratio J over a ten-node tet.

Its deformation gradient is linear, F = sum_c l_c F_c in barycentric coordinates l and corner values
F_c, so that J = det F is a homogeneous cubic polynomial. In Bernstein form J = sum B_a(l) b_a its
coefficients are (polarisation of the determinant)

    b_ijk = cof(F_i, F_j) : F_k / 6,   cof(A, B) = cof(A + B) - cof A - cof B

with b_iii = det F_i and b_iij = cof(F_i) : F_j / 3. The smallest coefficient bounds J from below,
as the B_a are positive and sum to one [Farouki 2012, The Bernstein polynomial basis]; J itself at
any corner bounds it from above.

The guard of an energy that does not bear inversion is a barrier in the coefficients [Toulorge et
al. 2013, Robust untangling of curvilinear meshes],

    mu V / 20 sum_a g(b_a),   g(b) = -(1 - y)^2 ln y,  y = b / J0, for b < J0 = 0.1, else 0,

that of [Li et al. 2020, eq. 6] in place of a distance: twice differentiable at J0, infinite at
b = 0. Finite energies thus have J > 0 everywhere. A tet with straight edges has b_a = J.

Energies that bear inversion have no guard. Between the two bounds a tet is bisected [Maubach 1995],
which only takes means of corner values, until every part has a positive bound or some corner has
J <= 0; for the smallest J itself, until no part can have a smaller one than was found. The gap of
the bounds falls with the square of the size of a part [Johnen, Remacle and Geuzaine 2013,
Geometrical validity of curvilinear finite elements].
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.principal import cofactor

wp.set_module_options({"enable_backward": False})

MAX_BISECTIONS = wp.constant(18)
"""Bisections of a part, three of which halve its edges: parts of 1/64 of the tet. J of what is
still undecided then lies within 1e-3 of zero, measured by the largest coefficient."""
MAX_PARTS = wp.constant(4096)
"""Parts that are looked at in one tet; more are needed only where J touches zero on a whole area
without falling below."""

RATIO_SLACK = wp.constant(wp.float64(1e-4))
"""How far below the smallest J that is named J may be."""


@wp.func
def mixed_cofactor(a: wp.mat33d, b: wp.mat33d) -> wp.mat33d:
    """cof(A + B) - cof A - cof B, without the differences."""
    a0 = wp.vec3d(a[0, 0], a[0, 1], a[0, 2])
    a1 = wp.vec3d(a[1, 0], a[1, 1], a[1, 2])
    a2 = wp.vec3d(a[2, 0], a[2, 1], a[2, 2])
    b0 = wp.vec3d(b[0, 0], b[0, 1], b[0, 2])
    b1 = wp.vec3d(b[1, 0], b[1, 1], b[1, 2])
    b2 = wp.vec3d(b[2, 0], b[2, 1], b[2, 2])
    return wp.matrix_from_rows(
        wp.cross(a1, b2) + wp.cross(b1, a2),
        wp.cross(a2, b0) + wp.cross(b2, a0),
        wp.cross(a0, b1) + wp.cross(b0, a1),
    )


COEFFICIENTS = wp.constant(20)
"""Coefficients of a cubic polynomial on a tet."""


@wp.func
def coefficient_corners(q: int) -> wp.vec3i:
    """Corners i <= j <= k whose values coefficient q of twenty is made of."""
    i = int(0)
    rest = int(q)
    # Pairs j <= k of corners from i on: (4 - i) (5 - i) / 2.
    while rest >= (4 - i) * (5 - i) / 2:
        rest -= (4 - i) * (5 - i) / 2
        i += 1
    j = int(i)
    while rest >= 4 - j:
        rest -= 4 - j
        j += 1
    return wp.vec3i(i, j, j + rest)


@wp.func
def coefficient(a: wp.mat33d, b: wp.mat33d, c: wp.mat33d) -> wp.float64:
    """b_ijk of corner values i, j and k, equal ones included."""
    return wp.ddot(mixed_cofactor(a, b), c) / wp.float64(6.0)


@wp.func
def least_with(f: wp.mat33d, a: wp.mat33d, b: wp.mat33d, c: wp.mat33d) -> wp.float64:
    """Smallest of the four coefficients in which corner value f comes twice or thrice."""
    cof = cofactor(f)
    others = wp.min(wp.min(wp.ddot(cof, a), wp.ddot(cof, b)), wp.ddot(cof, c))
    return wp.min(wp.determinant(f), others / wp.float64(3.0))


@wp.func
def least_coefficient(f0: wp.mat33d, f1: wp.mat33d, f2: wp.mat33d, f3: wp.mat33d) -> wp.float64:
    """Lower bound of J over the tet with these deformation gradients at its corners."""
    twice = wp.min(
        wp.min(least_with(f0, f1, f2, f3), least_with(f1, f2, f3, f0)),
        wp.min(least_with(f2, f3, f0, f1), least_with(f3, f0, f1, f2)),
    )
    m_01 = mixed_cofactor(f0, f1)
    m_23 = mixed_cofactor(f2, f3)
    once = wp.min(
        wp.min(wp.ddot(m_01, f2), wp.ddot(m_01, f3)),
        wp.min(wp.ddot(m_23, f0), wp.ddot(m_23, f1)),
    )
    return wp.min(twice, once / wp.float64(6.0))


@wp.func
def halved(f0: wp.mat33d, f1: wp.mat33d, f2: wp.mat33d, f3: wp.mat33d, cut: int, second: int):
    """Corner values of one half of a tet that is cut in the middle of the edge from corner 0 to
    corner ``cut``; the order of the corners makes edges take turns [Maubach 1995]."""
    half = wp.float64(0.5)
    a = f0
    b = f1
    c = f2
    d = f3
    if cut == 3:
        middle = half * (f0 + f3)
        d = middle
        if second != 0:
            a = f1
            b = f2
            c = f3
    elif cut == 2:
        middle = half * (f0 + f2)
        c = middle
        if second != 0:
            a = f1
            b = f2
    else:
        middle = half * (f0 + f1)
        b = middle
        if second != 0:
            a = f1
    return a, b, c, d


@wp.func
def least_corner(f0: wp.mat33d, f1: wp.mat33d, f2: wp.mat33d, f3: wp.mat33d) -> wp.float64:
    """Smallest J of the corners."""
    return wp.min(
        wp.min(wp.determinant(f0), wp.determinant(f1)),
        wp.min(wp.determinant(f2), wp.determinant(f3)),
    )


@wp.func
def lowest_found(
    f0: wp.mat33d,
    f1: wp.mat33d,
    f2: wp.mat33d,
    f3: wp.mat33d,
    known: wp.float64,
    enough: wp.float64,
    slack: wp.float64,
) -> wp.float64:
    """Smallest J that was found in the tet with these deformation gradients at its corners, or
    ``known`` where that is less; what is not a number comes out as such.

    Parts of the tet are left alone whose bound lies above ``enough``, or less than ``slack`` below
    what was found by then; at or below ``enough`` the search ends.
    """
    # The other way round, a corner that is not a number passes for in order.
    lowest = least_corner(f0, f1, f2, f3)
    if not (lowest > enough):
        return lowest
    lowest = wp.min(lowest, known)
    if least_coefficient(f0, f1, f2, f3) > wp.max(enough, lowest - slack):
        return lowest
    # Depth first, without a stack: the bits of ``path`` say which halves lead to the present part.
    path = int(0)
    depth = int(1)
    parts = int(0)
    while depth > 0 and parts < MAX_PARTS:
        parts += 1
        a, b, c, d = halved(f0, f1, f2, f3, 3, (path >> (depth - 1)) & 1)
        level = int(1)
        while level < depth:
            a, b, c, d = halved(a, b, c, d, 3 - level % 3, (path >> (depth - 1 - level)) & 1)
            level += 1
        here = least_corner(a, b, c, d)
        if not (here > enough):
            return here
        lowest = wp.min(lowest, here)
        bound = least_coefficient(a, b, c, d)
        if depth < MAX_BISECTIONS and not (bound > wp.max(enough, lowest - slack)):
            path = path << 1
            depth += 1
        else:
            while depth > 0 and (path & 1) == 1:
                path = path >> 1
                depth -= 1
            path = path | 1
    return lowest


@wp.func
def is_inside_out(f0: wp.mat33d, f1: wp.mat33d, f2: wp.mat33d, f3: wp.mat33d) -> bool:
    """Whether J <= 0 anywhere in the tet with these deformation gradients at its corners.

    Found to be so by a point where it is; where J only comes near zero (see ``MAX_BISECTIONS``),
    the tet passes.
    """
    infinite = wp.float64(wp.inf)
    return not (lowest_found(f0, f1, f2, f3, infinite, wp.float64(0.0), infinite) > wp.float64(0.0))


@wp.func
def smallest_ratio(
    f0: wp.mat33d, f1: wp.mat33d, f2: wp.mat33d, f3: wp.mat33d, known: wp.float64
) -> wp.float64:
    """Smallest J in the tet with these deformation gradients at its corners, or ``known`` where
    that is less; at most ``RATIO_SLACK`` too large, but see ``MAX_BISECTIONS``."""
    return lowest_found(f0, f1, f2, f3, known, wp.float64(-wp.inf), RATIO_SLACK)


GUARDED_RATIO = wp.constant(wp.float64(0.1))
"""J0: a gel under a sharp edge gets there, one under a finger tip does not."""


@wp.func
def ratio_barrier(j: wp.float64) -> wp.vec3d:
    """g and its first two derivatives; +inf where J <= 0."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    if j >= GUARDED_RATIO:
        return wp.vec3d(zero, zero, zero)
    if not (j > zero):
        return wp.vec3d(wp.float64(wp.inf), zero, zero)
    y = j / GUARDED_RATIO
    rest = one - y
    log_y = wp.log(y)
    return wp.vec3d(
        -rest * rest * log_y,
        (two * rest * log_y - rest * rest / y) / GUARDED_RATIO,
        (rest * (two + two + rest / y) / y - two * log_y) / (GUARDED_RATIO * GUARDED_RATIO),
    )
