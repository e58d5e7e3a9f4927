# SPDX-License-Identifier: Apache-2.0
"""Maps of a sampled surface: what its slopes and height say at each pixel.

Samples are those of ``SurfaceSampler``: slope along x and y, and height [m], NaN beside the pad.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import warp as wp

from taccel_lab.signals.raster import GridMap, pixel_xy, place_xy

wp.set_module_options({"enable_backward": False})


@wp.kernel
def height_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # Out
    height_m: wp.array3d(dtype=wp.float32),
):
    env, v, u = wp.tid()
    height_m[env, v, u] = samples[env, v, u][2]


@wp.kernel
def depth_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    rest_samples: wp.array3d(dtype=wp.vec3f),
    # Out
    depth_m: wp.array3d(dtype=wp.float32),
):
    env, v, u = wp.tid()
    depth_m[env, v, u] = rest_samples[env % rest_samples.shape[0], v, u][2] - samples[env, v, u][2]


@wp.kernel
def points_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    places: wp.array3d(dtype=wp.vec2f),
    grid: GridMap,
    # Out
    points_m: wp.array3d(dtype=wp.vec3f),
):
    env, v, u = wp.tid()
    height = samples[env, v, u][2]
    point = wp.vec3f(wp.nan, wp.nan, wp.nan)
    if not wp.isnan(height):
        xy = pixel_xy(grid, u, v)
        point = wp.vec3f(float(xy[0]), float(xy[1]), height)
        if places:
            # Of the face that a perspective camera looks at.
            place = places[env, v, u]
            xy = place_xy(grid, wp.float64(place[0]), wp.float64(place[1]))
            point = wp.vec3f(float(xy[0]), float(xy[1]), height)
    points_m[env, v, u] = point


@wp.kernel
def normals_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # Out
    normals: wp.array3d(dtype=wp.vec3f),
):
    env, v, u = wp.tid()
    s = samples[env, v, u]
    inverse = wp.float32(1.0) / wp.sqrt(wp.float32(1.0) + s[0] * s[0] + s[1] * s[1])
    normals[env, v, u] = wp.vec3f(-s[0] * inverse, -s[1] * inverse, inverse)
