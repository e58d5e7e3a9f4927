# SPDX-License-Identifier: Apache-2.0
"""Measures of tets in plain numpy: angles, mean ratios, and whether layers meet where they should.

Dihedral angles from the face normals; mean ratio eta = 12 (3 V)^(2/3) / sum of squared edge lengths
(Liu and Joe, BIT 34 (1994) 268), which is 1 for the regular tet and 0 for a flat one.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.mesh.surface import doubled_areas
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tet_mesh import tet_volumes

TET_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corners of each face of a tet, seen from outside."""
EDGE_PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
_OPPOSITE = np.array([[2, 3], [1, 3], [1, 2], [0, 3], [0, 2], [0, 1]])
_STEPS_MM = np.geomspace(1e-7, 2.0, 160)


def dihedral_angles_deg(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Dihedral angle at each of the six edges [deg], shape [tet_count, 6], edges as EDGE_PAIRS."""
    p = nodes[tets]
    start = p[:, EDGE_PAIRS[:, 0]]
    edge = p[:, EDGE_PAIRS[:, 1]] - start
    edge = edge / np.linalg.norm(edge, axis=-1, keepdims=True)
    arms = (p[:, _OPPOSITE[:, k]] - start for k in range(2))
    a, b = (arm - (arm * edge).sum(axis=-1, keepdims=True) * edge for arm in arms)
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    cosine = (a * b).sum(axis=-1)
    return np.rad2deg(np.arctan2(sine, cosine))


def mean_ratios(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Mean ratio eta of each tet, signed like the volume, shape [tet_count]."""
    volume = tet_volumes(nodes, tets)
    edges = nodes[tets[:, EDGE_PAIRS[:, 1]]] - nodes[tets[:, EDGE_PAIRS[:, 0]]]
    total = (edges**2).sum(axis=(1, 2))
    return np.sign(volume) * 12 * (3 * np.abs(volume)) ** (2 / 3) / total


def layer_errors(mesh: TetMesh, pad: Pad) -> dict[str, float]:
    """Greatest distance of the faces between layers from where those of the pad meet [mm]: along
    each normal, both ways, until the pad says that the layer changes, 2 mm where it does not. And
    the share of the volume in tets whose centre belongs to another layer than they do [%]."""
    volumes = mesh.volumes_m3()
    wrong = pad.layer_of(mesh.nodes_m[mesh.tets].mean(axis=1) * 1e3) != mesh.tet_layers
    return {
        "interface_error_mm": _interface_error_mm(mesh, pad),
        "misplaced_percent": float(100 * volumes[wrong].sum() / volumes.sum()),
    }


def _interface_error_mm(mesh: TetMesh, pad: Pad) -> float:
    faces = mesh.tets[:, TET_FACES].reshape(-1, 3)
    order = np.lexsort(np.sort(faces, axis=1).T)
    ordered, layers = np.sort(faces, axis=1)[order], np.repeat(mesh.tet_layers, 4)[order]
    between = (ordered[1:] == ordered[:-1]).all(axis=1) & (layers[1:] != layers[:-1])
    corners = 1e3 * mesh.nodes_m[faces[order[:-1][between]]]
    normals = doubled_areas(corners)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    center = corners.mean(axis=1, keepdims=True)
    # A little inside the face: its corners may lie on the outside of the body.
    near = center + 0.9 * (corners - center)
    points = np.concatenate([center, near], axis=1).reshape(-1, 3)
    along = np.repeat(normals, 4, axis=0)
    error = 0.0
    for step in _STEPS_MM:
        if not len(points):
            break
        error = float(step)
        same = pad.layer_of(points + step * along) == pad.layer_of(points - step * along)
        points, along = points[same], along[same]
    return error
