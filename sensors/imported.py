# SPDX-License-Identifier: Apache-2.0
"""A user's own gel from a file as the same files that a design gives.

A file has the gel's shape alone. Camera, lights, coating, material and markers are those of
the family that the sensor is said to be like, with the parameters that are given, and every block
of the profile says so.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from taccel_lab.cad.gel_import.gel_file import TOLERANCE_MM
from taccel_lab.cad.mesh.mesh_pad import MeshPad, SurfacePad
from taccel_lab.cad.mesh.quality import (
    GateResult,
    MeshQuality,
    QualityGate,
    check_quality,
    measure_quality,
    require_quality,
)
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.output_folder import atomic_directory, require_replaceable
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.geometry import TetMesh
from taccel_lab.guards import require_known
from taccel_lab.profile import Block, Provenance, SensorBlock, SensorProfile, save_profile
from taccel_lab.progress import Progress, silent
from taccel_lab.sensors.design import StageClock, refused_folder
from taccel_lab.sensors.profile import designed_profile
from taccel_lab.sensors.profile_family import (
    IMPORTED,
    LIKE_KEY,
    THICKNESS,
    imported_gel,
    require_no_shape,
)
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.sensors.workshop import Workshop, issue_of

if TYPE_CHECKING:
    from taccel_lab.cad.gel_import import FaceSelection, ImportedGel
    from taccel_lab.sensors.base import SensorFamily

LIKE = "flat_pad"
"""Family that an imported gel is like where nothing else is said."""
EDGE_MM = 2.0
"""Edge of the tets of an imported gel where nobody asks for another [mm]."""
IMPORT_PARTS = ("pad", "mould", "drawing")
"""Files for the workshop that an imported gel can have."""
MESHERS = {
    "tetwild": "fTetWild mesh of the gel of a file",
    "file": "the tets of a file, as they stand there",
}
"""Where the mesh of such a gel comes from, in words."""
_UNNAMED = ("", "COMPOUND", "SOLID")
"""What CAD programs call a body that nobody has named."""
_Block = TypeVar("_Block", bound=Block)


@dataclass(frozen=True)
class ImportResult:
    """What ``import_design`` made."""

    gel: ImportedGel
    profile: SensorProfile
    mesh: TetMesh
    quality: MeshQuality
    out_dir: Path
    files: dict[str, Path]
    """Written files by kind."""
    seconds: dict[str, float]
    """Time of each stage [s]."""
    assumed: dict[str, str]
    """What nobody has stated, and what was done to the file's body, in words."""
    deviation: dict[str, float]
    """Triangles, distance and tolerance of a simplified solid, as in gel.json."""


def import_design(
    path: Path | str,
    selection: FaceSelection,
    out_dir: Path | str,
    edge_mm: float | None = None,
    *,
    like: str = LIKE,
    overrides: Mapping[str, Any] | None = None,
    parts: Sequence[str] = IMPORT_PARTS,
    tolerance_mm: float = TOLERANCE_MM,
    progress: Progress = silent,
) -> ImportResult:
    """Import the gel of a file, mesh it and write everything to ``out_dir``.

    Tets of a file that pass the gate are kept, unless an edge length is asked for; all else is
    meshed with fTetWild, with edges of ``EDGE_MM``.

    Besides ``parts``: the labelled mesh, its quality, a picture, gel.json, which says what was
    selected and how the file's frame became the gel frame, and a profile with camera, lights and
    material of the family ``like``, ``overrides`` in place of some of its parameters.

    ``parts`` of a gel of many triangles are made of fewer, within ``tolerance_mm`` of the file's;
    where they cannot be, or there is no mould, InputError says so before anything is meshed.
    """
    for kind in parts:
        require_known("part of an imported gel", kind, IMPORT_PARTS)
    require_replaceable(out_dir)
    seconds: dict[str, float] = {}
    tell = StageClock(seconds, progress)
    refused = refused_folder(out_dir)
    path, out_dir, overrides = Path(path), Path(out_dir), overrides or {}
    gel = _checked(path, selection, like, overrides, tell)
    from taccel_lab.cad.export import dimensions
    from taccel_lab.cad.gel_import import WorkshopSolid, workshop_solid
    from taccel_lab.cad.preview import write_faces

    made = None if gel.part is None else WorkshopSolid(gel.part)
    if parts:
        tell("cad")
        made = workshop_solid(gel, tolerance_mm)
    solid = None if made is None else made.solid
    described = {} if solid is None else dimensions(solid)
    issue = issue_of({"body": gel.name, "thickness_mm": gel.thickness_mm, **described})
    layers = {} if solid is None else {"gel": solid}
    faceted = "" if made is None else made.faceted
    with atomic_directory(out_dir) as folder:
        workshop = Workshop(
            gel.name,
            folder,
            solid,
            gel.surface,
            layers,
            faceted=faceted,
            facets_mm=tolerance_mm if made is not None and made.deviation else 0.0,
            issue=issue,
        )
        for kind in parts:
            tell(kind)
            workshop.write(kind)
        found = _meshed(path, gel, edge_mm, like, overrides, refused, tell)
        if faceted:
            found.assumed["solid"] = f"moulds and drawings have {faceted}"
        tell("files")
        workshop.write_mesh(found.mesh, found.mesher)
        profile = found.profile()
        save_profile(profile, workshop.path("profile", "profile"))
        picture = workshop.path("faces", "faces.png")
        write_faces(gel.faces, gel.face_regions, gel.window_outline, picture, title=gel.name)
        tell(None)
        workshop.write_quality(found.quality, found.passed, found.mesher, found.edge_mm, seconds)
        deviation = {} if made is None else made.deviation
        write_json(
            workshop.path("gel", "gel.json"), _description(path, found, described, deviation)
        )
    return ImportResult(
        gel=gel,
        profile=profile,
        mesh=found.mesh,
        quality=found.quality,
        out_dir=out_dir,
        files={kind: out_dir / name for kind, name in workshop.files.items()},
        seconds=seconds,
        assumed=found.assumed,
        deviation=deviation,
    )


def imported_sensor(
    path: Path | str,
    selection: FaceSelection,
    edge_mm: float | None = None,
    *,
    like: str = LIKE,
    overrides: Mapping[str, Any] | None = None,
) -> SensorProfile:
    """The profile that ``import_design`` writes, without files."""
    path, overrides = Path(path), overrides or {}
    gel = _checked(path, selection, like, overrides)
    return _meshed(path, gel, edge_mm, like, overrides).profile()


@dataclass(frozen=True)
class _Meshed:
    """A gel and its mesh, which passed the gate."""

    path: Path
    gel: ImportedGel
    mesh: TetMesh
    mesher: str
    """Mesher, one of ``MESHERS``."""
    edge_mm: float
    quality: MeshQuality
    passed: GateResult
    assumed: dict[str, str]
    like: str
    overrides: Mapping[str, Any]

    def profile(self) -> SensorProfile:
        """Profile of the gel; what the family lends is assumed."""
        path, gel = self.path, self.gel
        pad = MeshPad(gel.thickness_mm, mesh=self.mesh)
        family = imported_gel(sensor_family(self.like), pad)
        parameters = family.parameters(self.overrides)
        base = designed_profile(family, parameters, self.mesh, self.quality, mesher=self.mesher)
        # The mesh says it.
        kept = {name: value for name, value in parameters.values().items() if name != THICKNESS}
        given = ", ".join(f"{name} = {value}" for name, value in self.overrides.items())
        method = f"that of {self.like}, which the sensor is said to be like"

        def assumed(block: _Block) -> _Block:
            source = block.provenance.source
            return block.replace(
                provenance=Provenance(kind="assumed", method=method, source=source)
            )

        file = Provenance(
            kind="designed",
            method="gel of a file; camera, lights and material as stated beside it",
            source=f"{path.name}, {gel.name}; like {self.like}"
            + (f" with {given}" if given else ""),
            inputs={path.name: file_sha256(path)},
        )
        blocks = {key: assumed(block) for key, block in base.blocks().items()}
        blocks["sensor"] = SensorBlock(
            name=_name(path.stem if gel.name in _UNNAMED else gel.name),
            family=IMPORTED,
            parameters={LIKE_KEY: self.like, **kept},
            provenance=file,
        )
        blocks["gel"] = base.gel.replace(provenance=file.replace(method=MESHERS[self.mesher]))
        profile = SensorProfile(mesh=self.mesh, **blocks)  # type: ignore[arg-type]
        for name in base.views:
            view = profile.with_block(assumed(base.seen_by(name).camera))
            optics = base.seen_by(name).optics
            if optics is not None:
                view = view.with_block(assumed(optics))
            profile = profile.with_view(name, view)
        return profile


def family_like(like: str, overrides: Mapping[str, Any]) -> SensorFamily:
    """The family that an imported gel is like; InputError for one that is not there, and for
    parameters that it lacks or that the gel's file gives."""
    family = sensor_family(like)
    require_no_shape(family, overrides)
    family.parameters_type.of(overrides)
    return family


def _untold(stage: str) -> None:
    """Nobody to tell which stage begins."""


def _checked(
    path: Path,
    selection: FaceSelection,
    like: str,
    overrides: Mapping[str, Any],
    tell: Callable[[str], None] = _untold,
) -> ImportedGel:
    """The gel of a file. Raises InputError also for a family, or a parameter, that an imported gel
    cannot take."""
    family = family_like(like, overrides)
    tell("import")
    from taccel_lab.cad.gel_import import import_gel

    gel = import_gel(path, selection)
    # Camera, markers and window against this gel: the profile would say it after minutes.
    imported_gel(family, SurfacePad(gel.thickness_mm, surface=gel.surface)).parameters(overrides)
    return gel


def _meshed(
    path: Path,
    gel: ImportedGel,
    edge_mm: float | None,
    like: str,
    overrides: Mapping[str, Any],
    refused: Path | None = None,
    tell: Callable[[str], None] = _untold,
) -> _Meshed:
    """The gel meshed; a mesh that is refused is drawn in the folder ``refused``."""
    from taccel_lab.cad.mesh.tetrahedralize import tetwild_mesh

    remade: dict[str, str] = {}

    def measured(mesh: TetMesh, edge_mm: float) -> tuple[MeshQuality, GateResult]:
        volume = gel.surface.volume_mm3() if gel.part is None else gel.part.volume_mm3
        quality = measure_quality(mesh, None, cad_volume_mm3=volume, cad_surface=gel.surface)
        return quality, check_quality(mesh, quality, QualityGate().at_edge(edge_mm))

    def result(
        mesh: TetMesh, mesher: str, edge: float, quality: MeshQuality, passed: GateResult
    ) -> _Meshed:
        assumed = gel.assumed | remade
        return _Meshed(path, gel, mesh, mesher, edge, quality, passed, assumed, like, overrides)

    tell("mesh")
    if gel.mesh is not None and edge_mm is None:
        quality, passed = measured(gel.mesh, EDGE_MM)
        if passed.passed:
            return result(gel.mesh, "file", EDGE_MM, quality, passed)
        remade["mesh"] = f"made anew, since {'; '.join(v.text for v in passed.violations)}"
    edge = EDGE_MM if edge_mm is None else edge_mm
    mesh = tetwild_mesh(gel.surface, edge, picture_folder=refused)
    tell("quality")
    quality, _ = measured(mesh, edge)
    passed = require_quality(mesh, quality, QualityGate().at_edge(edge), picture_folder=refused)
    return result(mesh, "tetwild", edge, quality, passed)


def _description(
    path: Path, found: _Meshed, measured: dict[str, Any], deviation: dict[str, float]
) -> dict[str, Any]:
    """What was read, selected and moved, as plain values."""
    gel = found.gel
    return {
        "file": path.name,
        "body": gel.name,
        "selection": gel.selection.model_dump(),
        "assumed": found.assumed,
        "gel_from_file": {"rotation_and_scale": gel.rotation, "shift_mm": gel.shift_mm},
        "min_thickness_mm": gel.min_thickness_mm,
        "thickness_mm": gel.thickness_mm,
        "part": measured,
        **({"workshop": deviation} if deviation else {}),
        "faces": [vars(face) for face in gel.faces.table],
    }


def _name(text: str) -> str:
    return re.sub(r"[^\w.+-]+", "_", text).strip("_") or IMPORTED
