# SPDX-License-Identifier: Apache-2.0
"""Height maps as faces: smooth ones as one polynomial patch, creased ones as a bicubic spline."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from math import comb

import numpy as np
from build123d import Face
from numpy.polynomial import chebyshev
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.collections import Array1_double, Array1_int, Array2_gp_Pnt, HArray2_gp_Pnt
from OCP.Geom import Geom_BezierSurface, Geom_BSplineSurface
from OCP.gp import gp_Pnt
from scipy.interpolate import RectBivariateSpline

_DEGREE = 3
_FACE_TOLERANCE_MM = 1e-6
_FIT_TOLERANCE_MM = 1e-5
_PATCH_DEGREES = (6, 8, 10, 12, 14)


def smooth_graph_face(height_mm: Callable[[np.ndarray], np.ndarray], bounds_mm: np.ndarray) -> Face:
    """The face z = height(x, y) over a rectangle as one Bezier patch.

    The kernel rolls fillets along its edges where a spline of many spans fails. Interpolated in
    Chebyshev points with the lowest degree that is true to 1e-5 mm, or the highest; a polynomial of
    degree six or less is met exactly.

    Args:
        height_mm: Heights [mm] of points xy [mm], [..., 2] -> [...], smooth over the rectangle.
        bounds_mm: Lowest and highest corner of the rectangle, shape [2, 2].
    """
    middle, half = bounds_mm.mean(axis=0), (bounds_mm[1] - bounds_mm[0]) / 2

    def on_square(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        grid = np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1)
        return height_mm(middle + half * grid)

    fine = np.linspace(-1, 1, 41)
    wanted = on_square(fine, fine)
    degree, series = 0, np.zeros((1, 1))
    for degree in _PATCH_DEGREES:
        nodes = chebyshev.chebpts1(degree + 1)
        inverse = np.linalg.inv(chebyshev.chebvander(nodes, degree))
        series = inverse @ on_square(nodes, nodes) @ inverse.T
        error = np.abs(chebyshev.chebgrid2d(fine, fine, series) - wanted).max()
        if error < _FIT_TOLERANCE_MM:
            break
    # The same polynomial in the basis of the patch, whose x and y are linear.
    t = 0.5 + 0.5 * chebyshev.chebpts1(degree + 1)
    order = np.arange(degree + 1)
    choose = np.array([comb(degree, int(i)) for i in order])
    bernstein = choose * t[:, None] ** order * (1 - t[:, None]) ** (degree - order)
    nodes = 2 * t - 1
    values = chebyshev.chebgrid2d(nodes, nodes, series)
    poles_z = np.linalg.solve(bernstein, np.linalg.solve(bernstein, values).T).T
    x, y = (middle[k] + half[k] * (2 * order / degree - 1) for k in range(2))
    poles = HArray2_gp_Pnt(1, degree + 1, 1, degree + 1)
    for i in order:
        for j in order:
            poles.SetValue(
                int(i) + 1, int(j) + 1, gp_Pnt(float(x[i]), float(y[j]), float(poles_z[i, j]))
            )
    return Face(BRepBuilderAPI_MakeFace(Geom_BezierSurface(poles), _FACE_TOLERANCE_MM).Face())


def creased_graph_face(
    height_mm: Callable[[np.ndarray], np.ndarray], x_mm: np.ndarray, y_mm: np.ndarray
) -> Face:
    """The face z = height(x, y) over a rectangle, through the heights on a grid.

    A spline in x and y is a graph when the x and y of its poles are the Greville abscissae of its
    knots (G. Farin, Curves and Surfaces for CAGD, 5th ed., section 8.6).

    Args:
        height_mm: Heights [mm] of points xy [mm], [..., 2] -> [...].
        x_mm: Grid lines along x, rising, at least four.
        y_mm: Grid lines along y.
    """
    values = height_mm(np.stack(np.meshgrid(x_mm, y_mm, indexing="ij"), axis=-1))
    spline = RectBivariateSpline(x_mm, y_mm, values, kx=_DEGREE, ky=_DEGREE)
    knots_x, knots_y = spline.get_knots()
    poles_z = spline.get_coeffs().reshape(len(x_mm), len(y_mm))
    poles_x, poles_y = _greville(knots_x), _greville(knots_y)
    poles = Array2_gp_Pnt(1, len(x_mm), 1, len(y_mm))
    for i, px in enumerate(poles_x):
        for j, py in enumerate(poles_y):
            poles.SetValue(i + 1, j + 1, gp_Pnt(float(px), float(py), float(poles_z[i, j])))
    surface = Geom_BSplineSurface(poles, *_knots(knots_x, knots_y), _DEGREE, _DEGREE)
    return Face(BRepBuilderAPI_MakeFace(surface, _FACE_TOLERANCE_MM).Face())


def _greville(knots: np.ndarray) -> np.ndarray:
    return np.convolve(knots[1:-1], np.full(_DEGREE, 1 / _DEGREE), mode="valid")


def _knots(knots_x: np.ndarray, knots_y: np.ndarray) -> list[object]:
    """Distinct knots of both axes, then their multiplicities, as the kernel's arrays."""
    reals, counts = [], []
    for knots in (knots_x, knots_y):
        values, multiplicities = np.unique(knots, return_counts=True)
        real = Array1_double(1, len(values))
        count = Array1_int(1, len(values))
        for i, (value, multiplicity) in enumerate(zip(values, multiplicities, strict=True)):
            real.SetValue(i + 1, float(value))
            count.SetValue(i + 1, int(multiplicity))
        reals.append(real)
        counts.append(count)
    return reals + counts
