# SPDX-License-Identifier: Apache-2.0
"""Do the layers of a mesh meet where those of its pad do?

The faces between tets of different layers are the mesh's interface. The pad only says which layer
a point belongs to, so the distance of a face from the true interface is found by going along the
face's normal, both ways, until the layer changes there.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.mesh.quality_measures import TET_FACES
from taccel_lab.cad.mesh.surface import doubled_areas
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.geometry import TetMesh

_CORNER_SHARE = 0.9
_STEPS_MM = np.geomspace(1e-7, 2.0, 160)


def interface_faces(mesh: TetMesh) -> np.ndarray:
    """Triangles between tets of different layers, int32, shape [n, 3], seen from the lower one."""
    faces = mesh.tets[:, TET_FACES].reshape(-1, 3)
    layers = np.repeat(mesh.tet_layers, 4)
    order = np.lexsort(np.sort(faces, axis=1).T)
    ordered = np.sort(faces, axis=1)[order]
    pair = np.flatnonzero((ordered[1:] == ordered[:-1]).all(axis=1))
    first, second = order[pair], order[pair + 1]
    differ = layers[first] != layers[second]
    first, second = first[differ], second[differ]
    return faces[np.where(layers[first] < layers[second], first, second)]


def interface_error_mm(mesh: TetMesh, pad: Pad) -> float:
    """Greatest distance of the mesh's interface from the pad's, along the face normals [mm].

    2 mm, the end of the search, where the pad has no interface; 0 for a mesh without interface.
    """
    faces = interface_faces(mesh)
    if not len(faces):
        return 0.0
    corners = mesh.nodes_m[faces] * 1e3
    normals = doubled_areas(corners)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    center = corners.mean(axis=1, keepdims=True)
    # A little inside the face: its corners may lie on the outside of the body.
    near = center + _CORNER_SHARE * (corners - center)
    points = np.concatenate([center, near], axis=1).reshape(-1, 3)
    along = np.repeat(normals, 4, axis=0)
    error = np.full(len(points), _STEPS_MM[-1])
    open_ = np.arange(len(points))
    for step in _STEPS_MM:
        p, n = points[open_], step * along[open_]
        crossed = pad.layer_of(p + n) != pad.layer_of(p - n)
        error[open_[crossed]] = step
        open_ = open_[~crossed]
        if not len(open_):
            break
    return float(error.max())


def misplaced_percent(mesh: TetMesh, pad: Pad) -> float:
    """Share of the volume in tets whose centre belongs to another layer than they do [%]."""
    volumes = mesh.volumes_m3()
    centers = mesh.nodes_m[mesh.tets].mean(axis=1) * 1e3
    wrong = pad.layer_of(centers) != mesh.tet_layers
    return float(100 * volumes[wrong].sum() / volumes.sum())
