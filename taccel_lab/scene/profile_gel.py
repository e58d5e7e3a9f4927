# SPDX-License-Identifier: Apache-2.0
"""The gel of a profile, and its material: uniform, or layers such as a core under a skin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.bodies.bodies import SoftBody
from taccel_lab.bodies.material import Material, MaterialField, MaterialModel
from taccel_lab.bodies.maxwell import MaxwellBranch
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh

if TYPE_CHECKING:
    from taccel_lab.profile import MaterialBlock, SensorProfile


def profile_gel(profile: SensorProfile, mesh: TetMesh | None = None, **options: Any) -> SoftBody:
    """The gel of a profile as a soft body: mesh, material and friction.

    Args:
        profile: Sensor.
        mesh: Of the same gel, finer or coarser; the profile's own when None.
        options: Further fields of ``SoftBody``, such as ``mount``, ``element``, ``surface``.
    """
    mesh = profile.mesh if mesh is None else mesh
    return SoftBody(
        mesh,
        profile_material(profile.material, mesh),
        friction_coefficient=profile.material.friction_coefficient,
        **options,
    )


def profile_material(block: MaterialBlock, mesh: TetMesh) -> Material | MaterialField:
    """Make the gel and the layers over it by the layers of ``mesh``; uniform for a mesh of one
    layer.

    Raises:
        InputError: The mesh has a layer that the block states no material for.
    """
    solids = (block, *block.layers)
    # Layers share the law, damping and branches of the gel, as the solver asks of one body.
    materials = [
        Material(
            solid.young_modulus_pa,
            solid.poisson_ratio,
            solid.density_kg_m3,
            model=MaterialModel(block.model),
            mooney_ratio=block.mooney_ratio,
            damping_time_s=block.damping_time_s,
            branches=profile_branches(block),
        )
        for solid in solids
    ]
    return layered_material(materials, mesh)


def profile_branches(block: MaterialBlock) -> tuple[MaxwellBranch, ...]:
    """Maxwell branches of a profile's gel."""
    return tuple(MaxwellBranch(entry.relative_modulus, entry.time_s) for entry in block.branches)


def layered_material(layers: Sequence[Material], mesh: TetMesh) -> Material | MaterialField:
    """The material of a mesh whose tets belong to layers; one for all where there is one layer.

    Args:
        layers: Material of each layer, in the order of ``mesh.tet_layers``.
        mesh: Gel pad.

    Raises:
        InputError: Fewer materials than layers, or layers whose model, damping or branches differ.
    """
    used = np.unique(mesh.tet_layers)
    if len(layers) <= used[-1]:
        raise InputError(f"the mesh has tets of layer {used[-1]}, but {len(layers)} materials")
    first = layers[used[0]]
    if len(used) == 1:
        return first
    for name in ("model", "damping_time_s", "branches"):
        found = {getattr(layers[layer], name) for layer in used}
        if len(found) > 1:
            raise InputError(f"layers of one gel must share {name}, got {sorted(found)}")
    values = {
        name: np.array([getattr(layer, name) for layer in layers])[mesh.tet_layers]
        for name in ("young_modulus_pa", "poisson_ratio", "density_kg_m3", "mooney_ratio")
    }
    return MaterialField(
        model=first.model,
        damping_time_s=first.damping_time_s,
        branches=first.branches,
        **values,
    )
