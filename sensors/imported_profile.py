# SPDX-License-Identifier: Apache-2.0
"""The profile of a sensor with a gel of one's own: all else is that of a catalogue family.

A file has the gel's shape alone. Camera, lights, coating, material and markers are those of
the family that the sensor is said to be like, with the parameters that are given, and every block
says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from taccel_lab.cad.mesh.mesh_pad import MeshPad
from taccel_lab.cad.mesh.quality import MeshQuality
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.geometry import TetMesh
from taccel_lab.profile import Block, Provenance, SensorBlock, SensorProfile
from taccel_lab.sensors.profile import designed_profile
from taccel_lab.sensors.profile_family import IMPORTED, LIKE_KEY, imported_gel
from taccel_lab.sensors.registry import sensor_family

if TYPE_CHECKING:
    from taccel_lab.cad.gel_import import ImportedGel

MESHERS = {
    "tetwild": "fTetWild mesh of the gel of a file",
    "file": "the tets of a file, as they stand there",
}
"""Where the mesh of such a gel comes from, in words."""
_UNNAMED = ("", "COMPOUND", "SOLID")
"""What CAD programs call a body that nobody has named."""
_Block = TypeVar("_Block", bound=Block)


def imported_profile(
    path: Path,
    gel: ImportedGel,
    mesh: TetMesh,
    quality: MeshQuality,
    like: str,
    overrides: Mapping[str, Any],
    mesher: str,
) -> SensorProfile:
    """Profile of the gel of a file.

    Raises InputError for a family or a parameter that is not there, for those of the family's own
    gel and housing, and for a camera inside the gel.
    """
    pad = MeshPad(gel.thickness_mm, mesh=mesh)
    family = imported_gel(sensor_family(like), pad)
    parameters = family.parameters(overrides)
    base = designed_profile(family, parameters, mesh, quality, mesher=mesher)
    given = ", ".join(f"{name} = {value}" for name, value in overrides.items())
    method = f"that of {like}, which the sensor is said to be like"

    def assumed(block: _Block) -> _Block:
        source = block.provenance.source
        return block.replace(provenance=Provenance(kind="assumed", method=method, source=source))

    file = Provenance(
        kind="designed",
        method="gel of a file; camera, lights and material as stated beside it",
        source=f"{path.name}, {gel.name}; like {like}" + (f" with {given}" if given else ""),
        inputs={path.name: file_sha256(path)},
    )
    profile = SensorProfile(
        sensor=SensorBlock(
            name=_name(path.stem if gel.name in _UNNAMED else gel.name),
            family=IMPORTED,
            parameters={LIKE_KEY: like, **parameters.values()},
            provenance=file,
        ),
        gel=base.gel.replace(
            provenance=file.replace(method=MESHERS[mesher]),
        ),
        material=assumed(base.material),
        camera=assumed(base.camera),
        mesh=mesh,
    )
    for key, block in base.blocks().items():
        if key not in ("sensor", "gel", "material", "camera"):
            profile = profile.with_block(assumed(block))
    for name in base.views:
        view = profile.with_block(assumed(base.seen_by(name).camera))
        optics = base.seen_by(name).optics
        if optics is not None:
            view = view.with_block(assumed(optics))
        profile = profile.with_view(name, view)
    return profile


def _name(text: str) -> str:
    return re.sub(r"[^\w.+-]+", "_", text).strip("_") or IMPORTED
