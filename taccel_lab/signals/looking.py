# SPDX-License-Identifier: Apache-2.0
"""Pixels of a perspective camera, looked up on the surface that its gel has now.

Surfaces, contacts and loads are computed on pixels over the gel (``GelCamera.face``). Each sight
line is followed to where it first meets that surface, in steps of about a pixel and then by false
position, and what is there is what the camera's pixel shows. Parts of the face that hang over are
not in it, and not seen.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import GelCamera
from taccel_lab.geometry import PixelGrid

wp.set_module_options({"enable_backward": False})

_SECANTS = wp.constant(5)
_MOST_STEPS = wp.constant(64)
"""Spans of more pixels are of domes, whose face is smooth at this many parts of them."""
_PARTS = wp.constant(8)
_STEEP_M = wp.constant(wp.float32(1e-4))
"""A face that rises by more within what is left of a step is a wall there."""
_MARGIN_M = wp.constant(wp.float32(1e-6))
_FAR_M = 1e3


@wp.func
def _weight(field: wp.array3d(dtype=wp.vec3f), row: int, j: int, i: int) -> wp.vec3f:
    if i < 0 or j < 0 or i >= field.shape[2] or j >= field.shape[1]:
        return wp.vec3f(wp.nan, wp.nan, wp.nan)
    return field[row, j, i]


@wp.func
def between(field: wp.array3d(dtype=wp.vec3f), row: int, place: wp.vec2f) -> wp.vec3f:
    """Bilinear at a place (column, row) of a field, the nearest pixel's where one is missing."""
    i = int(wp.floor(place[0]))
    j = int(wp.floor(place[1]))
    s = place[0] - float(i)
    t = place[1] - float(j)
    upper = (1.0 - s) * _weight(field, row, j, i) + s * _weight(field, row, j, i + 1)
    lower = (1.0 - s) * _weight(field, row, j + 1, i) + s * _weight(field, row, j + 1, i + 1)
    found = (1.0 - t) * upper + t * lower
    if wp.isnan(found[2]):
        near = _weight(field, row, int(wp.round(place[1])), int(wp.round(place[0])))
        if not wp.isnan(near[2]):
            found = near
    return found


@wp.kernel
def _range_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # In and out
    lowest: wp.array(dtype=wp.float32),
    highest: wp.array(dtype=wp.float32),
):
    row, v, u = wp.tid()
    z = samples[row, v, u][2]
    if not wp.isnan(z):
        wp.atomic_min(lowest, row, z)
        wp.atomic_max(highest, row, z)


@wp.func
def _place(
    entry: wp.vec3f, direction: wp.vec3f, t: float, px_per_m: wp.vec2f, center: wp.vec2f
) -> wp.vec2f:
    return wp.vec2f(
        (entry[0] + t * direction[0]) * px_per_m[0] + center[0],
        (entry[1] + t * direction[1]) * px_per_m[1] + center[1],
    )


@wp.func
def _height(samples: wp.array3d(dtype=wp.vec3f), row: int, place: wp.vec2f) -> float:
    """Height alone, as ``between`` has it."""
    i = int(wp.floor(place[0]))
    j = int(wp.floor(place[1]))
    if i < 0 or j < 0 or i + 1 >= samples.shape[2] or j + 1 >= samples.shape[1]:
        return between(samples, row, place)[2]
    s = place[0] - float(i)
    t = place[1] - float(j)
    upper = (1.0 - s) * samples[row, j, i][2] + s * samples[row, j, i + 1][2]
    lower = (1.0 - s) * samples[row, j + 1, i][2] + s * samples[row, j + 1, i + 1][2]
    z = (1.0 - t) * upper + t * lower
    if wp.isnan(z):
        z = between(samples, row, place)[2]
    return z


@wp.func
def _room(
    samples: wp.array3d(dtype=wp.vec3f),
    row: int,
    entry: wp.vec3f,
    direction: wp.vec3f,
    t: float,
    px_per_m: wp.vec2f,
    center: wp.vec2f,
) -> float:
    """Height of the face over a sight line [m], negative beyond it; NaN beside the face."""
    return (
        _height(samples, row, _place(entry, direction, t, px_per_m, center))
        - entry[2]
        - t * direction[2]
    )


@wp.kernel
def _meet_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    entries: wp.array2d(dtype=wp.vec3f),
    directions: wp.array2d(dtype=wp.vec3f),
    lowest: wp.array(dtype=wp.float32),
    highest: wp.array(dtype=wp.float32),
    px_per_m: wp.vec2f,
    center: wp.vec2f,
    # Out
    places: wp.array3d(dtype=wp.vec2f),
):
    """Place (column, row) on the face at which each sight line first meets it; NaN for none."""
    row, v, u = wp.tid()
    places[row, v, u] = wp.vec2f(wp.nan, wp.nan)
    entry = entries[v, u]
    direction = directions[v, u]
    if not (direction[2] > 0.0):
        return
    first = wp.max((lowest[row] - _MARGIN_M - entry[2]) / direction[2], 0.0)
    last = (highest[row] + _MARGIN_M - entry[2]) / direction[2]
    if not (last > first):
        return
    a = _place(entry, direction, first, px_per_m, center)
    b = _place(entry, direction, last, px_per_m, center)
    steps = wp.min(int(wp.ceil(wp.length(b - a))) + 1, _MOST_STEPS)
    low = wp.float32(first)
    # Above 0 while the line is in the gel.
    room = wp.float32(0.0)
    for k in range(steps + 1):
        t = first + (last - first) * float(k) / float(steps)
        now = _room(samples, row, entry, direction, t, px_per_m, center)
        if room > 0.0 and not (now > 0.0):
            # Through the face in this step, or out at its rim: shorter steps tell.
            part = (t - low) / float(_PARTS)
            if not wp.isnan(now) and steps < _MOST_STEPS:
                part = t - low
            high = low + part
            while high <= t + 0.5 * part:
                met = _room(samples, row, entry, direction, high, px_per_m, center)
                if wp.isnan(met):
                    high = 2.0 * t + part
                elif met > 0.0:
                    low = high
                    room = met
                    high = high + part
                else:
                    for _ in range(_SECANTS):
                        # False position, kept off the ends, which a step of the face would hold.
                        share = wp.clamp(room / (room - met), 0.05, 0.95)
                        middle = low + share * (high - low)
                        found = _room(samples, row, entry, direction, middle, px_per_m, center)
                        if found > 0.0:
                            low = middle
                            room = found
                        else:
                            high = middle
                            met = found
                    places[row, v, u] = _place(
                        entry, direction, 0.5 * (low + high), px_per_m, center
                    )
                    if room - met > 0.0 and met > -_STEEP_M:
                        share = room / (room - met)
                        places[row, v, u] = _place(
                            entry, direction, low + share * (high - low), px_per_m, center
                        )
                    return
            now = wp.float32(-1.0)
        room = wp.where(wp.isnan(now), wp.float32(-1.0), now)
        low = t


@wp.kernel
def _vectors_kernel(
    field: wp.array3d(dtype=wp.vec3f),
    places: wp.array3d(dtype=wp.vec2f),
    missing: wp.vec3f,
    # Out
    shown: wp.array3d(dtype=wp.vec3f),
):
    row, v, u = wp.tid()
    place = places[row, v, u]
    found = missing
    if not wp.isnan(place[0]):
        found = between(field, row % field.shape[0], place)
    shown[row, v, u] = found


@wp.kernel
def _numbers_kernel(
    field: wp.array3d(dtype=wp.float32),
    places: wp.array3d(dtype=wp.vec2f),
    # Out
    shown: wp.array3d(dtype=wp.float32),
):
    row, v, u = wp.tid()
    place = places[row, v, u]
    shown[row, v, u] = 0.0
    if not wp.isnan(place[0]):
        i = wp.clamp(int(wp.floor(place[0])), 0, field.shape[2] - 2)
        j = wp.clamp(int(wp.floor(place[1])), 0, field.shape[1] - 2)
        s = wp.clamp(place[0] - float(i), 0.0, 1.0)
        t = wp.clamp(place[1] - float(j), 0.0, 1.0)
        upper = (1.0 - s) * field[row, j, i] + s * field[row, j, i + 1]
        lower = (1.0 - s) * field[row, j + 1, i] + s * field[row, j + 1, i + 1]
        shown[row, v, u] = (1.0 - t) * upper + t * lower


@wp.kernel
def _flags_kernel(
    field: wp.array3d(dtype=wp.bool),
    places: wp.array3d(dtype=wp.vec2f),
    # Out
    shown: wp.array3d(dtype=wp.bool),
):
    row, v, u = wp.tid()
    place = places[row, v, u]
    shown[row, v, u] = False
    if not wp.isnan(place[0]):
        i = wp.clamp(int(wp.round(place[0])), 0, field.shape[2] - 1)
        j = wp.clamp(int(wp.round(place[1])), 0, field.shape[1] - 1)
        shown[row, v, u] = field[row, j, i]


class Looking:
    """What a perspective camera sees of up to ``rows`` gels."""

    def __init__(self, camera: GelCamera, face: PixelGrid, *, rows: int, device: Any) -> None:
        """
        Args:
            camera: Whose image it is.
            face: Pixels over the gel that surfaces are sampled on.
            rows: Most environments of one call.
            device: Warp device.
        """
        entry, direction = camera.sight_lines()
        lost = ~np.isfinite(direction).all(axis=-1)
        entry[lost], direction[lost] = 0.0, 0.0
        self._lines = [
            wp.array(values.astype(np.float32), dtype=wp.vec3f, device=device)
            for values in (1e-3 * entry, direction)
        ]
        self._map = [
            wp.vec2f(1e3 / face.mm_per_px_x, 1e3 / face.mm_per_px_y),
            wp.vec2f(face.center_u_px, face.center_v_px),
        ]
        self._range = [wp.empty(rows, dtype=wp.float32, device=device) for _ in range(2)]
        shape = (rows, camera.height_px, camera.width_px)
        self._places = wp.empty(shape, dtype=wp.vec2f, device=device)
        self._seen = [wp.empty(shape, dtype=wp.vec3f, device=device) for _ in range(2)]
        self._device = device

    def meet(self, samples: wp.array) -> wp.array:
        """Follow the sight lines to surfaces sampled over the gel, [row, ...]; returns the samples
        (slope along x, along y, height [m]) that the camera's pixels show."""
        rows = len(samples)
        lowest, highest = (array[:rows] for array in self._range)
        lowest.fill_(_FAR_M)
        highest.fill_(-_FAR_M)
        self._launch(_range_kernel, samples.shape, [samples], [lowest, highest])
        shape = (rows, *self._places.shape[1:])
        inputs = [samples, *self._lines, lowest, highest, *self._map]
        self._launch(_meet_kernel, shape, inputs, [self.places(rows)])
        return self.vectors(samples, self._seen[0][:rows], np.nan)

    def places(self, rows: int) -> wp.array:
        """Where the sight lines met the surfaces of ``meet``, (column, row) of the face."""
        return self._places[:rows]

    def rest(self, rest_samples: wp.array, rows: int) -> wp.array:
        """Samples at rest, [1, ...], of the points of the face that pixels show now."""
        return self.vectors(rest_samples, self._seen[1][:rows], np.nan)

    def vectors(self, field: wp.array, shown: wp.array, missing: float = 0.0) -> wp.array:
        """Vectors over the gel, by the camera's pixels: ``missing`` where these see no gel."""
        inputs = [field, self.places(len(shown)), wp.vec3f(missing)]
        self._launch(_vectors_kernel, shown.shape, inputs, [shown])
        return shown

    def show(self, field: wp.array, shown: wp.array) -> None:
        """Any field over the gel, by the camera's pixels; zero where these see none."""
        if shown.dtype == wp.vec3f:
            self.vectors(field, shown)
            return
        kernel = _flags_kernel if shown.dtype == wp.bool else _numbers_kernel
        self._launch(kernel, shown.shape, [field, self.places(len(shown))], [shown])

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)
