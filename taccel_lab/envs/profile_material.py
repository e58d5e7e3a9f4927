# SPDX-License-Identifier: Apache-2.0
"""The material that a profile states, for a mesh of its gel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taccel_lab.envs.layers import layered_material
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import Material, MaterialField, MaterialModel

if TYPE_CHECKING:
    from taccel_lab.profile import MaterialBlock


def profile_material(block: MaterialBlock, mesh: TetMesh) -> Material | MaterialField:
    """The gel and the layers over it by the layers of ``mesh``; uniform for a mesh of one layer.

    Raises:
        InputError: The mesh has a layer that the block states no material for.
    """
    solids = (block, *block.layers)
    # Layers share the law and the damping of the gel, as the solver asks of one body.
    materials = [
        Material(
            solid.young_modulus_pa,
            solid.poisson_ratio,
            solid.density_kg_m3,
            model=MaterialModel(block.model),
            mooney_ratio=block.mooney_ratio,
            damping_time_s=block.damping_time_s,
        )
        for solid in solids
    ]
    return layered_material(materials, mesh)
