# SPDX-License-Identifier: Apache-2.0
"""The contact surface as FP32 patches, one record a face, evaluated at pixels.

A face covers tens of pixels, so what they share is computed once, in FP64 by the formulas of
``clough_tocher``, and kept in FP32 where it loses nothing: pixel coordinates from the face's first
corner, control points from the face's centre. A record is twelve vec4f:

- 0: first corner rounded to a pixel (u, v); barycentric coordinate 1 there; its slope over u [1/px]
- 1: its slope over v; coordinate 2 there; its slopes over u and v
- 2: unused, so that records begin at whole sectors of memory
- 3 + 3 k: control points 0 to 8 of the sub-triangle opposite to corner k less the centre's, 0,
  and the centre's value
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportReturnType=false

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.signals.clough_tocher import (
    barycentric_slopes,
    control_points,
    evaluate_cubic,
)
from taccel_lab.signals.raster import GridMap, barycentric, pixel_xy, signed_area2, xy_of

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
