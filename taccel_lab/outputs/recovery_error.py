# SPDX-License-Identifier: Apache-2.0
"""How much the elements leave out, told from the solution alone.

The strain of elements jumps from one to the next; averaged at the nodes it is smooth, and usually
nearer to the truth. The energy of the difference over the whole is the estimate of Zienkiewicz and
Zhu (Int. J. Numer. Methods Eng. 24, 1987, 337-357). Only the deviatoric part counts: nearly
incompressible gels keep little energy in their volume, whatever their pressure is. A prescribed
press does its work against the force, so the relative error of the force is of the size of that of
the energy.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.geometry.quadratic import TET_EDGES

_OTHER = (5 - 5**0.5) / 20
_POINTS = _OTHER + 5**-0.5 * np.eye(4)
"""Barycentric coordinates of the quadrature points of ten-node tets, row by row."""


def relative_energy_error(
    mesh: TetMesh | QuadraticMesh,
    rest_m: np.ndarray,
    positions_m: np.ndarray,
    shear_modulus_pa: np.ndarray | float,
) -> float:
    """Estimated error of the elastic energy over the energy [1]; 0 for a gel at rest.

    ``rest_m`` and ``positions_m``: nodes of ``mesh`` [m], [node, 3]. ``shear_modulus_pa``: one or
    [tet]. Strains are Green's, so that rigid motion does not count.
    """
    tets = mesh.tets
    corners = rest_m[tets[:, :4]]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    gradients = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    volumes = np.linalg.det(edges) / 6
    moved = (positions_m - rest_m)[tets]
    at_corners = [_deviator(_slope(moved, gradients, point)) for point in np.eye(4)]
    sums, weights = np.zeros((mesh.node_count, 3, 3)), np.zeros(mesh.node_count)
    for corner in range(4):
        np.add.at(sums, tets[:, corner], at_corners[corner] * volumes[:, None, None])
        np.add.at(weights, tets[:, corner], volumes)
    smooth = sums / np.maximum(weights, np.finfo(float).tiny)[:, None, None]
    stiffness = volumes * shear_modulus_pa
    error = energy = 0.0
    for point in _POINTS:
        strain = _deviator(_slope(moved, gradients, point))
        recovered = np.tensordot(point, smooth[tets[:, :4]], axes=(0, 1))
        error += float((stiffness * ((recovered - strain) ** 2).sum(axis=(1, 2))).sum())
        energy += float((stiffness * (strain**2).sum(axis=(1, 2))).sum())
    return error / energy if energy > 0 else 0.0


def _slope(moved: np.ndarray, gradients: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Displacement gradient at barycentric coordinates ``point``, [tet, 3, 3]; ``moved`` [m] is
    [tet, 4 or 10, 3], ``gradients`` those of the coordinates [1/m], [tet, 4, 3]."""
    if moved.shape[1] == 4:
        shapes = gradients
    else:
        middles = [point[j] * gradients[:, i] + point[i] * gradients[:, j] for i, j in TET_EDGES]
        own = (4 * point[:, None] - 1) * gradients
        shapes = np.concatenate([own, 4 * np.stack(middles, axis=1)], axis=1)
    return np.einsum("tni,tnj->tij", moved, shapes)


def _deviator(slope: np.ndarray) -> np.ndarray:
    """Deviatoric part of Green's strain of displacement gradients [tet, 3, 3]."""
    strain = 0.5 * (slope + np.swapaxes(slope, 1, 2) + np.einsum("tki,tkj->tij", slope, slope))
    mean = np.trace(strain, axis1=1, axis2=2) / 3
    return strain - mean[:, None, None] * np.eye(3)
