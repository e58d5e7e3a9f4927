# SPDX-License-Identifier: Apache-2.0
"""Where the camera of a sensor sees points of its gel, on the device.

A point is seen in the direction whose sight line, bent at window and gel, passes through it. That
is found by shooting: two angles are corrected by Newton's method until the line meets the point.
``GelCamera.pixel_from_gel`` does the same on the host.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor structs.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportAttributeAccessIssue=false, reportReturnType=false

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import GelCamera, View
from taccel_lab.camera.refraction import DomeMedia
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.lens import fisheye_limit
from taccel_lab.signals.raster import GridMap, grid_map, pixel_of

wp.set_module_options({"enable_backward": False})

vec8d = wp.types.vector(length=8, dtype=wp.float64)

_SHOTS = wp.constant(8)
_STEP = wp.constant(wp.float64(1e-6))
_MISSED_MM = wp.constant(wp.float64(1e-6))
_NEVER = 1e6
"""Radius of an interface that is not there [mm]."""


@wp.struct
class Eye:
    """A view's camera; lengths in mm."""

    perspective: wp.int32
    """0: the gel is seen along its normal, by ``grid``."""
    grid: GridMap
    position: wp.vec3d
    camera_from_gel: wp.mat33d
    focal: wp.vec2d
    middle: wp.vec2d
    fisheye: wp.int32
    widest: wp.float64
    """Angle off the axis that a fisheye images [rad]."""
    lens: vec8d
    interfaces: wp.int32
    """Count of planes or spheres, at most 2."""
    dome: wp.int32
    centre: wp.vec3d
    places: wp.vec2d
    """z of planes, radii of spheres."""
    indices: wp.vec3d


@wp.struct
class _Ray:
    point: wp.vec3d
    direction: wp.vec3d


@wp.func
def _into_gel(eye: Eye, direction: wp.vec3d) -> _Ray:
    """The sight line that leaves the camera along a unit direction, in the gel."""
    ray = _Ray()
    ray.point = eye.position
    ray.direction = direction
    for k in range(eye.interfaces):
        normal = wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
        reach = (eye.places[k] - ray.point[2]) / ray.direction[2]
        if eye.dome != 0:
            off = ray.point - eye.centre
            along = wp.dot(off, ray.direction)
            reach = wp.sqrt(along * along - wp.dot(off, off) + eye.places[k] * eye.places[k])
            reach = reach - along
        ray.point = ray.point + reach * ray.direction
        if eye.dome != 0:
            normal = (ray.point - eye.centre) / eye.places[k]
        ratio = eye.indices[k] / eye.indices[k + 1]
        cosine = wp.dot(ray.direction, normal)
        beyond = wp.sqrt(wp.float64(1.0) - ratio * ratio * (wp.float64(1.0) - cosine * cosine))
        ray.direction = ratio * ray.direction + (beyond - ratio * cosine) * normal
    return ray


@wp.func
def _miss(
    eye: Eye, direction: wp.vec3d, point: wp.vec3d, first: wp.vec3d, second: wp.vec3d
) -> wp.vec2d:
    """Distances at which a sight line passes a point, along two directions [mm]."""
    ray = _into_gel(eye, wp.normalize(direction))
    away = ray.point + wp.dot(point - ray.point, ray.direction) * ray.direction - point
    return wp.vec2d(wp.dot(away, first), wp.dot(away, second))


@wp.func
def _sight(eye: Eye, point: wp.vec3d) -> wp.vec3d:
    """Direction at the camera in which a point of the gel is seen; NaN for none."""
    direct = wp.normalize(point - eye.position)
    if eye.interfaces == 0:
        return direct
    helper = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
    if wp.abs(direct[0]) >= wp.float64(0.7):
        helper = wp.vec3d(wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
    first = wp.normalize(wp.cross(direct, helper))
    second = wp.cross(direct, first)
    direction = direct
    miss = _miss(eye, direction, point, first, second)
    for _ in range(_SHOTS):
        a = (_miss(eye, direction + _STEP * first, point, first, second) - miss) / _STEP
        b = (_miss(eye, direction + _STEP * second, point, first, second) - miss) / _STEP
        det = a[0] * b[1] - a[1] * b[0]
        direction = direction - (b[1] * miss[0] - b[0] * miss[1]) / det * first
        direction = direction - (a[0] * miss[1] - a[1] * miss[0]) / det * second
        miss = _miss(eye, direction, point, first, second)
    if not (wp.length(miss) < _MISSED_MM):
        direction = wp.vec3d(wp.float64(wp.nan), wp.float64(wp.nan), wp.float64(wp.nan))
    return direction


@wp.func
def _through_lens(eye: Eye, direction: wp.vec3d) -> wp.vec2d:
    """Pixel of a direction in the gel's axes; see ``CameraModel``."""
    d = eye.camera_from_gel * direction
    k = eye.lens
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    nothing = wp.vec2d(wp.float64(wp.nan), wp.float64(wp.nan))
    if eye.fisheye != 0:
        across = wp.sqrt(d[0] * d[0] + d[1] * d[1])
        theta = wp.atan2(across, d[2])
        if not (theta <= eye.widest):
            return nothing
        t = theta * theta
        bent = theta * (one + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
        scale = wp.float64(0.0)
        if across > wp.float64(0.0):
            scale = bent / across
        return wp.cw_mul(eye.focal, scale * wp.vec2d(d[0], d[1])) + eye.middle
    if not (d[2] > wp.float64(0.0)):
        return nothing
    x = d[0] / d[2]
    y = d[1] / d[2]
    r = x * x + y * y
    radial = (one + r * (k[0] + r * (k[1] + r * k[4]))) / (one + r * (k[5] + r * (k[6] + r * k[7])))
    u = x * radial + two * k[2] * x * y + k[3] * (r + two * x * x)
    v = y * radial + k[2] * (r + two * y * y) + two * k[3] * x * y
    return wp.cw_mul(eye.focal, wp.vec2d(u, v)) + eye.middle


@wp.func
def seen_at(eye: Eye, point_m: wp.vec3d) -> wp.vec2d:
    """Pixel (u, v) that shows a point of the gel [m], in its frame; NaN for none."""
    if eye.perspective == 0:
        return pixel_of(eye.grid, point_m)
    return _through_lens(eye, _sight(eye, wp.float64(1000.0) * point_m))


def eye_of(view: View) -> Any:
    """The kernel-side form of a view."""
    eye = Eye()
    if isinstance(view, PixelGrid):
        eye.grid = grid_map(view)
        return eye
    eye.grid = grid_map(view.face)
    eye.perspective = 1
    _set_lens(eye, view)
    media = view.media
    if isinstance(media, DomeMedia):
        eye.dome, eye.centre, places = 1, wp.vec3d(*media.centre_mm), media.radii_mm
    else:
        places = media.planes_mm
    eye.interfaces = len(places)
    eye.places = wp.vec2d(*places, *[_NEVER] * (2 - len(places)))
    eye.indices = wp.vec3d(*media.indices, *[1.0] * (3 - len(media.indices)))
    return eye


def _set_lens(eye: Any, view: GelCamera) -> None:
    camera, model = view.camera, view.model
    eye.position = wp.vec3d(*camera.position_mm)
    eye.camera_from_gel = wp.mat33d(*model.gel_from_camera.T.ravel().tolist())
    eye.focal = wp.vec2d(camera.fx_px, camera.fy_px)
    eye.middle = wp.vec2d(camera.cx_px, camera.cy_px)
    lens = np.zeros(8)
    lens[: len(camera.distortion)] = camera.distortion
    eye.lens = vec8d(*lens.tolist())
    if camera.model == "fisheye":
        eye.fisheye, eye.widest = 1, fisheye_limit(lens[:4])
