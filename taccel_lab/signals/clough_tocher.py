# SPDX-License-Identifier: Apache-2.0
r"""C1 interpolation of nodal values and gradients: the reduced Clough-Tocher cubic macro-element.

Each triangle is split at its centroid G into three cubics in Bernstein form. With the value f_i
and gradient g_i of each corner V_i the control points are

- on the edges        ``b_ij = f_i + g_i . (V_j - V_i) / 3``
- around a corner     ``s_i  = (f_i + b_ij + b_ik) / 3``
- inside sub-triangle ``m_ij``: makes the derivative across edge ij linear along the edge, so both
  triangles of the edge agree on it (they share its end values)
- on the spokes       ``t_i  = (s_i + m_ij + m_ik) / 3``, centre ``c = (t_1 + t_2 + t_3) / 3``.

Quadratics are reproduced exactly. Source: R. W. Clough, J. L. Tocher (1965); control points after
G. Farin, "Triangular Bernstein-Bezier patches", CAGD 3 (1986) 83-127, section 6.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})

vec10d = wp.types.vector(length=10, dtype=wp.float64)


@wp.func
def edge_middle(
    vi: wp.vec2d,
    vj: wp.vec2d,
    centroid: wp.vec2d,
    fi: wp.float64,
    fj: wp.float64,
    bij: wp.float64,
    bji: wp.float64,
    si: wp.float64,
    sj: wp.float64,
) -> wp.float64:
    """Inner control point m_ij of the sub-triangle (V_i, V_j, G).

    The normal direction of edge ij has the barycentric form (t - 1, -t, 1); the Bernstein
    coefficients of the derivative along it are linear when the middle one is the mean of the ends.
    """
    edge = vj - vi
    t = wp.dot(centroid - vi, edge) / wp.dot(edge, edge)
    di = t - wp.float64(1.0)
    start = di * fi - t * bij + si
    end = di * bji - t * fj + sj
    return wp.float64(0.5) * (start + end) - di * bij + t * bji


@wp.func
def control_points(
    v0: wp.vec2d,
    v1: wp.vec2d,
    v2: wp.vec2d,
    f: wp.vec3d,
    g0: wp.vec2d,
    g1: wp.vec2d,
    g2: wp.vec2d,
    sub: int,
) -> vec10d:
    """Bernstein coefficients of the sub-triangle opposite to corner ``sub``.

    With its corners (P, Q, G): f_P, b_PQ, b_QP, f_Q, s_P, m_PQ, s_Q, t_P, t_Q, c.
    """
    third = wp.float64(1.0) / wp.float64(3.0)
    centroid = (v0 + v1 + v2) * third
    b01 = f[0] + wp.dot(g0, v1 - v0) * third
    b02 = f[0] + wp.dot(g0, v2 - v0) * third
    b10 = f[1] + wp.dot(g1, v0 - v1) * third
    b12 = f[1] + wp.dot(g1, v2 - v1) * third
    b20 = f[2] + wp.dot(g2, v0 - v2) * third
    b21 = f[2] + wp.dot(g2, v1 - v2) * third
    s0 = (f[0] + b01 + b02) * third
    s1 = (f[1] + b10 + b12) * third
    s2 = (f[2] + b20 + b21) * third
    m01 = edge_middle(v0, v1, centroid, f[0], f[1], b01, b10, s0, s1)
    m12 = edge_middle(v1, v2, centroid, f[1], f[2], b12, b21, s1, s2)
    m20 = edge_middle(v2, v0, centroid, f[2], f[0], b20, b02, s2, s0)
    t0 = (s0 + m01 + m20) * third
    t1 = (s1 + m01 + m12) * third
    t2 = (s2 + m12 + m20) * third
    c = (t0 + t1 + t2) * third
    if sub == 0:
        return vec10d(f[1], b12, b21, f[2], s1, m12, s2, t1, t2, c)
    if sub == 1:
        return vec10d(f[2], b20, b02, f[0], s2, m20, s0, t2, t0, c)
    return vec10d(f[0], b01, b10, f[1], s0, m01, s1, t0, t1, c)


@wp.func
def evaluate_cubic(k: Any, p: Any, q: Any, r: Any) -> Any:
    """Value and derivatives to (p, q, r) of a Bernstein cubic at barycentric (p, q, r).

    ``k``: ten coefficients as of ``control_points``, FP64 or FP32 like the coordinates.
    """
    three = type(p)(3.0)
    two = type(p)(2.0)
    # Quadratics left after one de Casteljau step: their values are the derivatives over three.
    dp = p * p * k[0] + two * p * q * k[1] + q * q * k[2]
    dp = dp + two * p * r * k[4] + two * q * r * k[5] + r * r * k[7]
    dq = p * p * k[1] + two * p * q * k[2] + q * q * k[3]
    dq = dq + two * p * r * k[5] + two * q * r * k[6] + r * r * k[8]
    dr = p * p * k[4] + two * p * q * k[5] + q * q * k[6]
    dr = dr + two * p * r * k[7] + two * q * r * k[8] + r * r * k[9]
    return wp.vector(p * dp + q * dq + r * dr, three * dp, three * dq, three * dr)


@wp.func
def barycentric_slopes(v0: wp.vec2d, v1: wp.vec2d, v2: wp.vec2d, corner: int) -> wp.vec2d:
    """Gradient of the barycentric coordinate of ``corner`` [1/m]."""
    a = v1
    b = v2
    if corner == 1:
        a = v2
        b = v0
    if corner == 2:
        a = v0
        b = v1
    area2 = (v1[0] - v0[0]) * (v2[1] - v0[1]) - (v1[1] - v0[1]) * (v2[0] - v0[0])
    return wp.vec2d(a[1] - b[1], b[0] - a[0]) / area2
