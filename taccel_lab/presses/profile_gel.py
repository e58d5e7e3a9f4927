# SPDX-License-Identifier: Apache-2.0
"""The gel of a profile as a scene, as a body and as a material: uniform, or layers such as a core
under a skin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import (
    Material,
    MaterialField,
    MaterialModel,
    MaxwellBranch,
    Scene,
    SoftBody,
)
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from taccel_lab.profile import MaterialBlock, SensorProfile


@typed
def profile_scene(
    profile: SensorProfile,
    *,
    mesh: TetMesh | None = None,
    gel: Mapping[str, Any] | None = None,
    **scene: Any,
) -> Scene:
    """Make a scene whose soft body is the gel of a profile.

    ``SignalTactile.from_profile(profile, solver=...)`` then shows what that sensor sees.

    Args:
        profile: Sensor: mesh, material, friction.
        mesh: Of the same gel, coarser for many environments (``Sensor.meshed``); the profile's own
            when None.
        gel: Further fields of its ``SoftBody``, such as ``mount`` and ``element``.
        scene: Arguments of ``Scene``: ``kinematic_bodies``, ``env_count``, ...

    Raises:
        InputError: What ``SoftBody`` and ``Scene`` refuse.
    """
    return Scene(profile_gel(profile, mesh, **(gel or {})), **scene)


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


@typed
def profile_material(block: MaterialBlock, mesh: TetMesh) -> Material | MaterialField:
    """Make the gel and the layers over it by the layers of ``mesh``; uniform for a mesh of one
    layer.

    Raises:
        InputError: The mesh has a layer that the block states no material for.
    """
    solids = (block, *block.layers)
    branches = tuple(MaxwellBranch(one.relative_modulus, one.time_s) for one in block.branches)
    # Layers share the law and the branches of the gel, as the solver asks of one body.
    materials = [
        Material(
            solid.young_modulus_pa,
            solid.poisson_ratio,
            solid.density_kg_m3,
            model=MaterialModel(block.model),
            mooney_ratio=block.mooney_ratio,
            branches=branches,
        )
        for solid in solids
    ]
    return layered_material(materials, mesh)


def layered_material(layers: Sequence[Material], mesh: TetMesh) -> Material | MaterialField:
    """The material of a mesh whose tets belong to layers; one for all where there is one layer.

    Args:
        layers: Material of each layer, in the order of ``mesh.tet_layers``.
        mesh: Gel pad.

    Raises:
        InputError: Fewer materials than layers, or layers whose model or branches differ.
    """
    used = np.unique(mesh.tet_layers)
    if len(layers) <= used[-1]:
        raise InputError(f"the mesh has tets of layer {used[-1]}, but {len(layers)} materials")
    first = layers[used[0]]
    if len(used) == 1:
        return first
    for name in ("model", "branches"):
        found = {getattr(layers[layer], name) for layer in used}
        if len(found) > 1:
            raise InputError(f"layers of one gel must share {name}, got {sorted(found)}")
    values = {
        name: np.array([getattr(layer, name) for layer in layers])[mesh.tet_layers]
        for name in ("young_modulus_pa", "poisson_ratio", "density_kg_m3", "mooney_ratio")
    }
    return MaterialField(
        model=first.model,
        branches=first.branches,
        **values,
    )
