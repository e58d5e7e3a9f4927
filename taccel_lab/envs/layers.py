# SPDX-License-Identifier: Apache-2.0
"""Materials of gels in layers, such as a translucent core under a black skin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import Material, MaterialField


def layered_material(layers: Sequence[Material], mesh: TetMesh) -> Material | MaterialField:
    """The material of a mesh whose tets belong to layers; one for all where there is one layer.

    Args:
        layers: Material of each layer, in the order of ``mesh.tet_layers``.
        mesh: Gel pad.

    Raises:
        InputError: Fewer materials than layers, or layers whose model or damping differ.
    """
    used = np.unique(mesh.tet_layers)
    if len(layers) <= used[-1]:
        raise InputError(f"the mesh has tets of layer {used[-1]}, but {len(layers)} materials")
    first = layers[used[0]]
    if len(used) == 1:
        return first
    for name in ("model", "damping_time_s"):
        found = {getattr(layers[layer], name) for layer in used}
        if len(found) > 1:
            raise InputError(f"layers of one gel must share {name}, got {sorted(found)}")
    values = {
        name: np.array([getattr(layer, name) for layer in layers])[mesh.tet_layers]
        for name in ("young_modulus_pa", "poisson_ratio", "density_kg_m3", "mooney_ratio")
    }
    return MaterialField(model=first.model, damping_time_s=first.damping_time_s, **values)
