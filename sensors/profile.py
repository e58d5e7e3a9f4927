# SPDX-License-Identifier: Apache-2.0
"""The profile of a sensor that has been designed but not yet calibrated."""

from __future__ import annotations

from cad.mesh.gel_mesh import gel_mesh
from cad.mesh.quality import MeshQuality, measure_quality, require_quality
from sensors.base import FamilyParameters, SensorFamily
from sensors.registry import sensor_family
from taccel_lab.geometry import TetMesh
from taccel_lab.profile import (
    CameraBlock,
    GelBlock,
    MaterialBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
)


def designed_profile(
    family: SensorFamily,
    parameters: FamilyParameters,
    mesh: TetMesh,
    quality: MeshQuality,
    *,
    mesher: str,
) -> SensorProfile:
    """Profile with the blocks sensor, gel, material and camera; each states what it rests on."""
    described = parameters.describe()

    def sources(*names: str) -> str:
        return "; ".join(f"{name}: {described[name]['source']}" for name in names)

    geometry = [name for name in described if name.endswith("_mm") or name == "rim"]
    material = parameters.material()
    return SensorProfile(
        sensor=SensorBlock(
            name=family.name,
            family=family.name,
            parameters=parameters.values(),
            provenance=Provenance(
                kind="designed",
                method="parameters of the catalogue's family, with the overrides given",
                source="; ".join(family.references) or family.title,
            ),
        ),
        gel=GelBlock(
            thickness_mm=parameters.pad().thickness_mm,
            node_count=mesh.node_count,
            tet_count=mesh.tet_count,
            min_dihedral_deg=quality.min_dihedral_deg,
            provenance=Provenance(
                kind="designed",
                method=f"{mesher} mesh of the parametric pad",
                source=sources(*geometry),
            ),
        ),
        material=MaterialBlock(
            young_modulus_pa=material.young_modulus_pa,
            poisson_ratio=material.poisson_ratio,
            density_kg_m3=material.density_kg_m3,
            friction_coefficient=material.friction_coefficient,
            provenance=Provenance(
                kind="assumed",
                method="defaults of the catalogue's family, with the overrides given",
                source="; ".join(
                    f"{name}: {item['source']}"
                    for name, item in described.items()
                    if item["group"] == "material"
                ),
            ),
        ),
        camera=CameraBlock.from_grid(
            parameters.grid(),
            Provenance(
                kind="published",
                method="pixel grid of the catalogue's family, with the overrides given",
                source=sources(*(name for name in described if name.endswith("px"))),
            ),
        ),
        mesh=mesh,
    )


def catalogue_profile(name: str) -> SensorProfile:
    """Profile of a catalogue sensor with its default parameters and the structured mesh."""
    family = sensor_family(name)
    parameters = family.parameters()
    mesh = gel_mesh(parameters.pad())
    quality = measure_quality(mesh, parameters.pad())
    require_quality(mesh, quality)
    return designed_profile(family, parameters, mesh, quality, mesher="structured")
