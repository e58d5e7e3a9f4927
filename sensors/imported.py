# SPDX-License-Identifier: Apache-2.0
"""A user's own gel from a STEP file as the same files that a design gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.cad.mesh.quality import MeshQuality, QualityGate, measure_quality, require_quality
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.output_folder import atomic_directory, require_replaceable
from taccel_lab.geometry import TetMesh
from taccel_lab.profile import SensorProfile, save_profile
from taccel_lab.progress import Progress, silent
from taccel_lab.sensors.design import StageClock, refused_folder
from taccel_lab.sensors.imported_profile import imported_profile
from taccel_lab.sensors.profile_family import require_no_shape
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.sensors.workshop import Workshop, check_parts, issue_of

if TYPE_CHECKING:
    from taccel_lab.cad.step_import import FaceSelection, ImportedGel

LIKE = "flat_pad"
"""Family that an imported gel is like where nothing else is said."""
IMPORT_PARTS = ("pad", "mould", "drawing")
"""Files for the workshop that an imported gel can have."""


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


def import_design(
    path: Path | str,
    selection: FaceSelection,
    out_dir: Path | str,
    edge_mm: float = 2.0,
    *,
    like: str = LIKE,
    overrides: Mapping[str, Any] | None = None,
    parts: Sequence[str] = IMPORT_PARTS,
    progress: Progress = silent,
) -> ImportResult:
    """Import the gel of a STEP file, mesh it with fTetWild and write everything to ``out_dir``.

    Besides ``parts``: the labelled mesh, its quality, a picture, gel.json, which says what was
    selected and how the file's frame became the gel frame, and a profile with camera, lights and
    material of the family ``like``, ``overrides`` in place of some of its parameters.
    """
    _require_like(like, overrides or {})
    check_parts(parts)
    if "assembly" in parts:
        raise InputError(
            f"an imported gel has no assembly; parts are any of {', '.join(IMPORT_PARTS)}"
        )
    require_replaceable(out_dir)
    seconds: dict[str, float] = {}
    tell = StageClock(seconds, progress)
    from taccel_lab.cad.export import dimensions

    refused = refused_folder(out_dir)
    gel, mesh, quality, passed = _meshed(path, selection, edge_mm, refused, tell)
    tell("files")
    out_dir = Path(out_dir)
    with atomic_directory(out_dir) as folder:
        solid = {"body": gel.name, "thickness_mm": gel.thickness_mm, **dimensions(gel.part)}
        workshop = Workshop(
            gel.name, folder, gel.part, gel.surface, {"gel": gel.part}, issue=issue_of(solid)
        )
        for kind in parts:
            tell(kind)
            workshop.write((kind,))
        tell("files")
        workshop.write_mesh(mesh, "tetwild")
        profile = imported_profile(Path(path), gel, mesh, quality, like, overrides or {})
        save_profile(profile, workshop.path("profile", "profile"))
        tell(None)
        workshop.write_quality(quality, passed, "tetwild", edge_mm, seconds)
        description = _description(Path(path), selection, gel, dimensions)
        write_json(workshop.path("gel", "gel.json"), description)
    return ImportResult(
        gel=gel,
        profile=profile,
        mesh=mesh,
        quality=quality,
        out_dir=out_dir,
        files={kind: out_dir / name for kind, name in workshop.files.items()},
        seconds=seconds,
    )


def imported_sensor(
    path: Path | str,
    selection: FaceSelection,
    edge_mm: float = 2.0,
    *,
    like: str = LIKE,
    overrides: Mapping[str, Any] | None = None,
) -> SensorProfile:
    """The profile that ``import_design`` writes, without files."""
    _require_like(like, overrides or {})
    gel, mesh, quality, _ = _meshed(path, selection, edge_mm, None, lambda stage: None)
    return imported_profile(Path(path), gel, mesh, quality, like, overrides or {})


def _require_like(like: str, overrides: Mapping[str, Any]) -> None:
    """Raises InputError for a family or a parameter that an imported gel cannot take."""
    family = sensor_family(like)
    require_no_shape(family, overrides)
    family.parameters(overrides)


def _meshed(
    path: Path | str,
    selection: FaceSelection,
    edge_mm: float,
    refused: Path | None,
    tell: Callable[[str], None],
) -> tuple[ImportedGel, TetMesh, MeshQuality, Any]:
    """The gel, its mesh with its quality, and the limits that it passed; a mesh that is refused is
    drawn in the folder ``refused``."""
    tell("import")
    from taccel_lab.cad.mesh.tetrahedralize import tetwild_mesh
    from taccel_lab.cad.step_import import import_gel

    gel = import_gel(path, selection)
    tell("mesh")
    mesh = tetwild_mesh(gel.surface, edge_mm, picture_folder=refused)
    tell("quality")
    quality = measure_quality(
        mesh, None, cad_volume_mm3=gel.part.volume_mm3, cad_surface=gel.surface
    )
    gate = QualityGate().at_edge(edge_mm)
    return gel, mesh, quality, require_quality(mesh, quality, gate, picture_folder=refused)


def _description(
    path: Path,
    selection: FaceSelection,
    gel: ImportedGel,
    dimensions: Callable[..., dict[str, Any]],
) -> dict[str, Any]:
    """What was read, selected and moved, as plain values."""
    return {
        "file": path.name,
        "body": gel.name,
        "selection": selection.model_dump(),
        "assumed": selection.assumed(),
        "gel_from_file": {"rotation_and_scale": gel.rotation, "shift_mm": gel.shift_mm},
        "min_thickness_mm": gel.min_thickness_mm,
        "thickness_mm": gel.thickness_mm,
        "part": dimensions(gel.part),
        "faces": [vars(face) for face in gel.faces],
    }
