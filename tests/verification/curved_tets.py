# SPDX-License-Identifier: Apache-2.0
"""Two quadratic tets, one of them bent inside out where neither a corner nor a quadrature point
tells."""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.scene import SoftBody

SIDE = 1e-3
_NODES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]]) * SIDE
_TETS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
CURVED = TetMesh(_NODES, _TETS, boundary_faces(_TETS), np.zeros(6, dtype=np.int32))
"""All edges straight; corners 0 to 3 are those of the tet that ``curved`` bends."""
_BENT = SIDE * np.array(
    [
        [-0.10, 0.35, -0.03],
        [0.26, -0.14, -0.40],
        [-0.35, -0.16, -0.16],
        [-0.40, -0.36, 0.31],
        [0.00, 0.14, 0.22],
        [0.09, 0.06, 0.14],
    ]
)
"""Of the middles of the first tet's edges [m], found by a random search: J is at least 0.16 at its
corners, 0.51 at its quadrature points, and -2.3 inside."""


def curved(soft: SoftBody, share: float = 1.0) -> np.ndarray:
    """Displacement [m] of the nodes of a quadratic body of ``CURVED``, [node_count, 3]."""
    moved = np.zeros((soft.nodal_mesh.node_count, 3))
    moved[soft.nodal_mesh.tets[0, 4:]] = share * _BENT
    return moved
