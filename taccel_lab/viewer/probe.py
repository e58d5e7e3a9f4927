# SPDX-License-Identifier: Apache-2.0
"""The value at a point that was clicked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.viewer.section import SectionSurface


@dataclass(frozen=True)
class Probe:
    """Where a ray met a surface first."""

    point: np.ndarray
    """[3], in the unit of the surface."""
    value: float
    """Linear between the corners of the triangle; NaN where one of them is not known."""


def probe(
    surfaces: list[SectionSurface], origin: np.ndarray, direction: np.ndarray
) -> Probe | None:
    """The first hit of a ray with surfaces; None where it passes them.

    Möller and Trumbore 1997, "Fast, minimum storage ray-triangle intersection".

    Args:
        surfaces: With values at their points.
        origin: Start of the ray, [3].
        direction: Of the ray, any length but 0, [3].
    """
    best, nearest = None, np.inf
    for surface in surfaces:
        a, b, c = (surface.points[surface.faces[:, k]] for k in range(3))
        one, two = b - a, c - a
        across = np.cross(direction, two)
        determinant = np.einsum("ij,ij->i", one, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = origin - a
            u = np.einsum("ij,ij->i", away, across) / determinant
            turned = np.cross(away, one)
            v = turned @ direction / determinant
            along = np.einsum("ij,ij->i", two, turned) / determinant
            # Rays along a triangle give no finite numbers, and no hit.
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0) & np.isfinite(along)
        if not hit.any():
            continue
        k = int(np.flatnonzero(hit)[along[hit].argmin()])
        if along[k] < nearest:
            nearest = float(along[k])
            weights = np.array([1 - u[k] - v[k], u[k], v[k]])
            corners = surface.faces[k]
            value = float(weights @ surface.values[corners])
            best = Probe(weights @ surface.points[corners], value)
    return best
