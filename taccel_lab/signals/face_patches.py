# SPDX-License-Identifier: Apache-2.0
"""The contact surface as FP32 patches, one record a face, evaluated at pixels.

A face covers tens of pixels, so what they share is computed once, in FP64 by the formulas
below, and kept in FP32 where it loses nothing: pixel coordinates from the face's first
corner, control points from the face's centre. A record is twelve vec4f:

- 0: first corner rounded to a pixel (u, v); barycentric coordinate 1 there; its slope over u [1/px]
- 1: its slope over v; coordinate 2 there; its slopes over u and v
- 2: unused, so that records begin at whole sectors of memory
- 3 + 3 k: control points 0 to 8 of the sub-triangle opposite to corner k less the centre's, 0,
  and the centre's value

C1 interpolation of nodal values and gradients: the reduced Clough-Tocher cubic macro-element.

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
# pyright: reportReturnType=false

from __future__ import annotations

from typing import Any

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.signals.raster import GridMap, barycentric, pixel_xy, signed_area2, xy_of

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


wp.set_module_options({"enable_backward": False})

RECORD = wp.constant(12)
"""Words of four floats in a record."""

vec10f = wp.types.vector(length=10, dtype=wp.float32)


@wp.func_native(native("face_patches", "load4"))
def load4(data: wp.array(dtype=wp.vec4f), i: int) -> wp.vec4f:
    """``data[i]`` in one access of 16 bytes."""
    ...


@wp.func_native(native("face_patches", "store4"))
def store4(data: wp.array(dtype=wp.vec4f), i: int, a: float, b: float, c: float, d: float):
    """``data[i] = (a, b, c, d)`` in one access of 16 bytes."""
    ...


@wp.kernel
def build_patches_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    values: wp.array2d(dtype=wp.float64),
    gradients: wp.array2d(dtype=wp.vec2d),
    faces: wp.array2d(dtype=wp.int32),
    grid: GridMap,
    min_area2: wp.float64,
    # Out
    patches: wp.array(dtype=wp.vec4f),
    folded: wp.array(dtype=wp.int32),
):
    """Records of all faces; marks environments with a folded face (or NaN)."""
    env, face = wp.tid()
    i0 = faces[face, 0]
    i1 = faces[face, 1]
    i2 = faces[face, 2]
    # Written so that NaN counts as folded.
    if not (signed_area2(positions[env, i0], positions[env, i1], positions[env, i2]) > min_area2):
        folded[env] = 1
        return
    v0 = xy_of(positions[env, i0])
    v1 = xy_of(positions[env, i1])
    v2 = xy_of(positions[env, i2])
    f = wp.vec3d(values[env, i0], values[env, i1], values[env, i2])
    slope1 = barycentric_slopes(v0, v1, v2, 1)
    slope2 = barycentric_slopes(v0, v1, v2, 2)
    g0 = gradients[env, i0]
    g1 = gradients[env, i1]
    g2 = gradients[env, i2]
    u = int(wp.round(v0[0] * grid.px_per_m[0] + grid.center_px[0]))
    v = int(wp.round(v0[1] * grid.px_per_m[1] + grid.center_px[1]))
    bary = barycentric(pixel_xy(grid, u, v), v0, v1, v2)
    first = (env * faces.shape[0] + face) * RECORD
    store4(
        patches,
        first,
        float(u),
        float(v),
        float(bary[1]),
        float(slope1[0] / grid.px_per_m[0]),
    )
    store4(
        patches,
        first + 1,
        float(slope1[1] / grid.px_per_m[1]),
        float(bary[2]),
        float(slope2[0] / grid.px_per_m[0]),
        float(slope2[1] / grid.px_per_m[1]),
    )
    for sub in range(3):
        k = control_points(v0, v1, v2, f, g0, g1, g2, sub)
        c = k[9]
        at = first + 3 + 3 * sub
        store4(patches, at, float(k[0] - c), float(k[1] - c), float(k[2] - c), float(k[3] - c))
        store4(patches, at + 1, float(k[4] - c), float(k[5] - c), float(k[6] - c), float(k[7] - c))
        store4(patches, at + 2, float(k[8] - c), float(0.0), float(c), float(0.0))


@wp.func
def patch_barycentric(place: wp.vec4f, rest: wp.vec4f, u: int, v: int) -> wp.vec3f:
    """Barycentric coordinates of a pixel from the first two words of a record."""
    du = float(u) - place[0]
    dv = float(v) - place[1]
    b1 = place[2] + place[3] * du + rest[0] * dv
    b2 = rest[1] + rest[2] * du + rest[3] * dv
    return wp.vec3f(1.0 - b1 - b2, b1, b2)


@wp.func
def lowest_corner(bary: wp.vec3f) -> int:
    """Corner of the least coordinate."""
    corner = wp.where(bary[1] < bary[0], 1, 0)
    return wp.where(bary[2] < wp.min(bary[0], bary[1]), 2, corner)


@wp.func
def evaluate_patch(
    patches: wp.array(dtype=wp.vec4f),
    first: int,
    place: wp.vec4f,
    rest: wp.vec4f,
    bary: wp.vec3f,
    px_per_m: wp.vec2f,
) -> wp.vec3f:
    """Sample (slope along x, slope along y, height [m]) at barycentric coordinates of a record."""
    slope1 = wp.vec2f(place[3] * px_per_m[0], rest[0] * px_per_m[1])
    slope2 = wp.vec2f(rest[2] * px_per_m[0], rest[3] * px_per_m[1])
    slope0 = -slope1 - slope2
    sub = lowest_corner(bary)
    # The sub-triangle's corners are P, Q and the centre; sub, P, Q run around the face.
    low = bary[0]
    p = bary[1]
    q = bary[2]
    slope_low = slope0
    slope_p = slope1
    slope_q = slope2
    if sub == 1:
        low = bary[1]
        p = bary[2]
        q = bary[0]
        slope_low = slope1
        slope_p = slope2
        slope_q = slope0
    if sub == 2:
        low = bary[2]
        p = bary[0]
        q = bary[1]
        slope_low = slope2
        slope_p = slope0
        slope_q = slope1
    at = first + 3 + 3 * sub
    ka = load4(patches, at)
    kb = load4(patches, at + 1)
    kc = load4(patches, at + 2)
    k = vec10f(ka[0], ka[1], ka[2], ka[3], kb[0], kb[1], kb[2], kb[3], kc[0], kc[1])
    found = evaluate_cubic(k, p - low, q - low, 3.0 * low)
    slope = (
        found[1] * (slope_p - slope_low)
        + found[2] * (slope_q - slope_low)
        + found[3] * 3.0 * slope_low
    )
    return wp.vec3f(slope[0], slope[1], kc[2] + found[0])
