# SPDX-License-Identifier: Apache-2.0
"""The log barrier of IPC and the contact potential per unit of area.

`unit_barrier` is that of Li et al. (2020), Incremental Potential Contact, eq. 6, on y = d / dhat:

    g(y) = -(y - 1)^2 ln(y) for 0 < y < 1, else 0.

`contact_potential` is its area-weighted, dimensionless form (Li, Kaufman, Jiang 2023, Convergent
Incremental Potential Contact): with a stiffness = kappa [Pa] * area [m^2],

    E(d) = stiffness * dhat * g(d / dhat)

so that the contact pressure is kappa |g'(y)|, whatever dhat and the mesh are.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def unit_barrier(y: wp.float64) -> wp.float64:
    """g(y) = -(y - 1)^2 ln y, zero from y = 1 on."""
    if y >= wp.float64(1.0):
        return wp.float64(0.0)
    gap = y - wp.float64(1.0)
    return -gap * gap * wp.log(y)


@wp.func
def unit_barrier_d1(y: wp.float64) -> wp.float64:
    """g'(y) = -(y - 1) (2 ln y + (y - 1) / y)."""
    if y >= wp.float64(1.0):
        return wp.float64(0.0)
    gap = y - wp.float64(1.0)
    return -gap * (wp.float64(2.0) * wp.log(y) + gap / y)


@wp.func
def unit_barrier_d2(y: wp.float64) -> wp.float64:
    """g''(y) = -2 ln y - 4 (y - 1) / y + ((y - 1) / y)^2."""
    if y >= wp.float64(1.0):
        return wp.float64(0.0)
    ratio = (y - wp.float64(1.0)) / y
    return -wp.float64(2.0) * wp.log(y) - wp.float64(4.0) * ratio + ratio * ratio


@wp.func
def unit_gap(pressure: wp.float64) -> wp.float64:
    """Gap y at which |g'(y)| is ``pressure``: 1 at none, to a part in 1e-6."""
    low = wp.float64(0.0)
    high = wp.float64(1.0)
    for _ in range(20):
        middle = wp.float64(0.5) * (low + high)
        if -unit_barrier_d1(middle) > pressure:
            low = middle
        else:
            high = middle
    return high


@wp.func
def contact_potential(distance: wp.float64, dhat: wp.float64, stiffness: wp.float64) -> wp.float64:
    """Potential energy [J] of a collision; stiffness = kappa [Pa] * area [m^2]."""
    return stiffness * dhat * unit_barrier(distance / dhat)


@wp.func
def contact_potential_d1(
    distance: wp.float64, dhat: wp.float64, stiffness: wp.float64
) -> wp.float64:
    """dE/dd [N]; its negative is the normal force."""
    return stiffness * unit_barrier_d1(distance / dhat)


@wp.func
def contact_potential_d2(
    distance: wp.float64, dhat: wp.float64, stiffness: wp.float64
) -> wp.float64:
    """d2E/dd2 [N/m]."""
    return stiffness / dhat * unit_barrier_d2(distance / dhat)
