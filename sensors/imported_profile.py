# SPDX-License-Identifier: Apache-2.0
"""The profile of a sensor with a gel of one's own: all else is that of a catalogue family.

A STEP file has the gel's shape alone. Camera, lights, coating, material and markers are those of
the family that the sensor is said to be like, with the parameters that are given, and every block
says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from taccel_lab.cad.mesh.quality import MeshQuality
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.profile import Block, Provenance, SensorBlock, SensorProfile
from taccel_lab.reading.regular_file import file_sha256
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.profile import designed_profile
from taccel_lab.sensors.registry import IMPORTED, sensor_family

if TYPE_CHECKING:
    from taccel_lab.cad.step_import import ImportedGel

_Block = TypeVar("_Block", bound=Block)
_SHAPES = ("gel", "housing")
"""Groups of parameters of no use here: the file says the gel's, and there is no housing."""


def imported_profile(
    path: Path,
    gel: ImportedGel,
    mesh: TetMesh,
    quality: MeshQuality,
    like: str,
    overrides: Mapping[str, Any],
) -> SensorProfile:
    """Profile of the gel of a file, see ``like_parameters`` for what is refused."""
    family, parameters = sensor_family(like), like_parameters(like, overrides)
    base = designed_profile(
        family, parameters, mesh, quality, mesher="tetwild", thickness_mm=gel.thickness_mm
    )
    given = ", ".join(f"{name} = {value}" for name, value in overrides.items())
    method = f"that of {like}, which the sensor is said to be like"

    def assumed(block: _Block) -> _Block:
        source = block.provenance.source
        return block.replace(provenance=Provenance(kind="assumed", method=method, source=source))

    file = Provenance(
        kind="designed",
        method="gel of a STEP file; camera, lights and material as stated beside it",
        source=f"{path.name}, {gel.name}; like {like}" + (f" with {given}" if given else ""),
        inputs={path.name: file_sha256(path)},
    )
    profile = SensorProfile(
        sensor=SensorBlock(name=_name(gel.name), family=IMPORTED, provenance=file),
        gel=base.gel.replace(
            provenance=file.replace(method="fTetWild mesh of the gel of a STEP file"),
        ),
        # One material: the file does not say where a skin would be.
        material=assumed(base.material.replace(layers=())),
        camera=assumed(base.camera),
        mesh=mesh,
    )
    for key, block in base.blocks().items():
        if key in ("sensor", "gel", "material", "camera", "housing"):
            continue
        if key == "window":
            extent = np.ptp(mesh.nodes_m[mesh.region_nodes(Region.CONTACT), :2], axis=0) * 1e3
            block = block.replace(size_mm=tuple(float(side) for side in extent))
        profile = profile.with_block(assumed(block))
    return profile


def _name(text: str) -> str:
    return re.sub(r"[^\w.+-]+", "_", text).strip("_") or IMPORTED


def like_parameters(like: str, overrides: Mapping[str, Any]) -> FamilyParameters:
    """Parameters of the family that an imported gel is like. Raises InputError for a family or a
    parameter that is not there, and for those of the family's own gel and housing."""
    parameters = sensor_family(like).parameters(overrides)
    described = parameters.describe()
    groups = {name: item["group"] or "gel" for name, item in described.items()}
    useless = [name for name in overrides if groups[name] in _SHAPES]
    if useless:
        allowed = ", ".join(sorted({*groups.values()} - {*_SHAPES}))
        raise InputError(
            f"{', '.join(useless)}: of no use beside a file, which gives the gel's shape; "
            f"parameters of {allowed} can be set"
        )
    return parameters
