# SPDX-License-Identifier: Apache-2.0
"""How much the elements leave out, told from the solution alone.

The strain of elements jumps from one to the next; averaged at the nodes it is smooth, and usually
nearer to the truth. The energy of the difference over the whole is the estimate of Zienkiewicz and
Zhu (Int. J. Numer. Methods Eng. 24, 1987, 337-357). A prescribed press does its work against the
force, so the relative error of the force is of the size of that of the energy.

Ten-node tets resist their volume as a whole and keep little energy in it: their deviatoric strains
count. In four-node tets volumetric locking shows as jumps of the dilatation, which count too.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.geometry.quadratic import TET_EDGES

_OTHER = (5 - 5**0.5) / 20
_POINTS = _OTHER + 5**-0.5 * np.eye(4)
"""Barycentric coordinates of the quadrature points of ten-node tets, row by row (symmetric)."""


def relative_energy_error(
    mesh: TetMesh | QuadraticMesh,
    rest_m: np.ndarray,
    positions_m: np.ndarray,
    shear_modulus_pa: np.ndarray | float,
    lame_lambda_pa: np.ndarray | float,
) -> float:
    """Estimated error of the elastic energy over the energy [1]; 0 for a gel at rest.

    ``rest_m`` and ``positions_m``: nodes of ``mesh`` [m], [node, 3]. Moduli: one or [tet]. Strains
    are Green's, so that rigid motion does not count.
    """
    tets = mesh.tets
    corner = tets[:, :4]
    edges = rest_m[corner[:, 1:]] - rest_m[corner[:, :1]]
    inverse = np.swapaxes(np.linalg.inv(edges), 1, 2)
    gradients = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    volumes = np.linalg.det(edges) / 6
    slopes = _corner_slopes((positions_m - rest_m)[tets], gradients)
    at_corners = volumes[:, None] * _green_strain(slopes)
    count = mesh.node_count
    weights = np.bincount(corner.ravel(), np.repeat(volumes, 4), count)
    sums = np.stack([np.bincount(corner.ravel(), part.ravel(), count) for part in at_corners])
    smooth = (sums / np.maximum(weights, np.finfo(float).tiny))[:, corner]
    # A field of second order has slopes that are linear in each tet.
    strains = _green_strain(slopes @ _POINTS)
    shear = volumes * shear_modulus_pa
    bulk = 0.5 * volumes * (lame_lambda_pa + 2 / 3 * np.asarray(shear_modulus_pa))
    if tets.shape[1] != 4:
        bulk = 0.0 * bulk

    def energy(strain: np.ndarray) -> float:
        volumetric = strain[:3].sum(axis=0)
        squares = (strain[:3] ** 2).sum(axis=0) + 2 * (strain[3:] ** 2).sum(axis=0)
        deviatoric = squares - volumetric**2 / 3
        return float((shear[:, None] * deviatoric + bulk[:, None] * volumetric**2).sum())

    whole = energy(strains)
    # Rigid motion leaves strains of rounding.
    return energy(smooth @ _POINTS - strains) / whole if whole > 1e-24 * shear.sum() else 0.0


def _corner_slopes(moved: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """Displacement gradients at the corners, [3, 3, tet, corner]; ``moved`` [m] is [tet, 4 or 10,
    3], ``gradients`` those of the barycentric coordinates [1/m], [tet, 4, 3]."""
    tets, nodes = moved.shape[:2]
    by_coordinate = np.zeros((4, 4, nodes))
    """Derivatives of the shapes by the barycentric coordinates at each corner."""
    for at in range(4):
        by_coordinate[at, :, :4] = np.eye(4)
        if nodes > 4:
            by_coordinate[at, range(4), range(4)] = 4.0 * np.eye(4)[at] - 1.0
            for middle, (a, b) in enumerate(TET_EDGES, start=4):
                by_coordinate[at, a, middle] = 4.0 * (at == b)
                by_coordinate[at, b, middle] = 4.0 * (at == a)
    values = np.swapaxes(moved, 1, 2).reshape(-1, nodes) @ by_coordinate.reshape(16, nodes).T
    slopes = values.reshape(tets, 12, 4) @ gradients
    return np.ascontiguousarray(slopes.reshape(tets, 3, 4, 3).transpose(1, 3, 0, 2))


def _green_strain(slope: np.ndarray) -> np.ndarray:
    """Green's strains xx, yy, zz, xy, yz, xz of displacement gradients [3, 3, ...]."""
    return np.stack(
        [
            0.5 * (slope[i, j] + slope[j, i] + (slope[:, i] * slope[:, j]).sum(axis=0))
            for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
        ]
    )
