# SPDX-License-Identifier: Apache-2.0
"""Optical models of gels whose contact face is a formula: what is right is then known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from taccel_lab.optics.frames import PreviewImage
from taccel_lab.optics.render import OpticalModel
from taccel_lab.optics.surface import FineFace
from taccel_lab.profile.optical_design import OpticalDesign

Height = Callable[[np.ndarray], np.ndarray]
"""Height over gel xy [mm], [..., 2] -> [...], NaN beside the pad; such as ``Pad.top_mm``."""


def height_face(
    top_mm: Callable[[np.ndarray], np.ndarray], x_mm: np.ndarray, y_mm: np.ndarray
) -> FineFace:
    """The face ``z = top_mm(xy)`` on a grid, from a formula such as ``Pad.top_mm``.

    Args:
        top_mm: Height over gel xy, [..., 2] -> [...], NaN beside the pad.
        x_mm: Columns of the grid, ascending, shape [nx].
        y_mm: Rows, ascending, shape [ny].
    """
    xy = np.stack(np.meshgrid(x_mm, y_mm, indexing="xy"), axis=-1)
    z = top_mm(xy)
    step = 1e-3 * float(min(np.diff(x_mm).min(), np.diff(y_mm).min()))
    slopes = []
    for offset in (np.array([step, 0.0]), np.array([0.0, step])):
        ahead, behind = top_mm(xy + offset), top_mm(xy - offset)
        central = (ahead - behind) / (2 * step)
        one_sided = np.where(np.isnan(ahead), z - behind, ahead - z) / step
        slopes.append(np.where(np.isnan(central), one_sided, central))
    index = np.arange(z.size).reshape(z.shape)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    points = np.concatenate([xy, z[..., None]], axis=-1).reshape(-1, 3)
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(z)], axis=-1).reshape(-1, 3)
    good = np.isfinite(points.sum(axis=1) + normals.sum(axis=1))
    triangles = triangles[good[triangles].all(axis=1)]
    points[~good], normals[~good] = 0.0, [0.0, 0.0, 1.0]
    edge = float(np.median(np.diff(x_mm)))
    return FineFace(
        points,
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        triangles.astype(np.int32),
        edge,
    )


def formula_face(top_mm: Height, half_size_mm: tuple[float, float], step_mm: float) -> FineFace:
    """The face over twice ``half_size_mm`` in steps of ``step_mm``."""
    x, y = (
        np.linspace(-half, half, 2 * max(1, round(half / step_mm)) + 1) for half in half_size_mm
    )
    return height_face(top_mm, x, y)


def formula_model(
    design: OpticalDesign,
    top_mm: Height,
    *,
    half_size_mm: tuple[float, float],
    back_z_mm: float,
    step_mm: float = 0.1,
    **options: Any,
) -> OpticalModel:
    """The untouched gel over a flat back; ``options`` as of ``OpticalModel``."""
    face = formula_face(top_mm, half_size_mm, step_mm)
    half_x, half_y = half_size_mm
    corners = [[x, y, back_z_mm] for x in (-half_x, half_x) for y in (-half_y, half_y)]
    return OpticalModel(design, None, face=face, back_mm=np.array(corners), **options)


def render_formula(
    model: OpticalModel, top_mm: Height, half_size_mm: tuple[float, float], step_mm: float
) -> PreviewImage:
    """Another face, such as a pressed one, in the light and exposure of ``model``."""
    return model.picture(model.light_of(formula_face(top_mm, half_size_mm, step_mm)))
