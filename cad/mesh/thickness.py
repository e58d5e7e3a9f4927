# SPDX-License-Identifier: Apache-2.0
"""How thin a closed surface gets: a body without thickness somewhere cannot be meshed there."""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.mesh.surface import doubled_areas

_PROBES = 600
_OPPOSITE = -0.9
_AREA_SHARE = 1e-6


def least_thickness(vertices: np.ndarray, triangles: np.ndarray) -> tuple[float, np.ndarray]:
    """Least thickness seen from the middles of triangles, straight inward, and where it is.

    A ray counts where it meets a face that looks the other way, so that the sharp edge between two
    faces is not taken for a thin sheet. Up to about 1,000 triangles are probed, evenly; infinite
    when no ray meets such a face.
    """
    corners = vertices[triangles]
    cross = doubled_areas(corners)
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(2 * areas, 1e-300)[:, None]
    real = np.flatnonzero(areas > _AREA_SHARE * areas.sum())
    probes = real[:: max(len(real) // _PROBES, 1)]
    starts = corners[probes].mean(axis=1)
    best, where = np.inf, np.zeros(3)
    for k, start in zip(probes, starts, strict=True):
        opposite = normals @ normals[k] < _OPPOSITE
        distance = _first_hit(start, -normals[k], corners[opposite])
        if distance < best:
            best, where = distance, start
    return float(best), where


def _first_hit(start: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> float:
    """Distance along a ray to the nearest of some triangles (Moeller and Trumbore, 1997)."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge2)
    determinant = (edge1 * p).sum(axis=1)
    good = np.abs(determinant) > 1e-300
    inverse = np.where(good, 1 / np.where(good, determinant, 1), 0)
    offset = start - corners[:, 0]
    u = (offset * p).sum(axis=1) * inverse
    q = np.cross(offset, edge1)
    v = (q @ direction) * inverse
    t = (edge2 * q).sum(axis=1) * inverse
    hit = good & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > -1e-9)
    return float(t[hit].min(initial=np.inf))
