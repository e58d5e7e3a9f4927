# SPDX-License-Identifier: Apache-2.0
"""Files of other programs that hold a gel: their faces shown, a gel read, checked and labelled.

The CAD kernel crashes on some STEP files, so it meets one in the readers' process only, where
``step_gel`` holds all that becomes of it. Triangles and tets are read there, too. What comes back
has passed every check.
"""

from __future__ import annotations

import os
import re
from collections.abc import Hashable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.cad.gel_import.importer import FaceInfo, FaceSelection, ImportedGel, PartFaces
from taccel_lab.cad.gel_import.selection import rectangle_of
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.errors import InputError, naming
from taccel_lab.files import tet_file, triangle_file
from taccel_lab.files.apart import read_apart
from taccel_lab.files.declared import require_few_copies
from taccel_lab.files.regular_file import read_regular_file, require_regular_file
from taccel_lab.geometry import Region
from taccel_lab.guards import require_known, require_range

if TYPE_CHECKING:
    from taccel_lab.cad.parts.part import LabelledSolid

STEP = (".step", ".stp")
SUFFIXES = (*STEP, *triangle_file.SUFFIXES, *tet_file.SUFFIXES)
"""Endings of files that a gel is read from."""
LIMIT_S = 120.0
"""Time limit of the CAD kernel with a file: 271 faces take it 8 s."""
MAX_FACETS = 1_000
"""Triangles of a gel that get a solid; the CAD kernel makes moulds of them in a minute."""
TOLERANCE_MM = 0.05
"""Distance of the solid of more triangles from these [mm]: half of what ISO 3302-1 class M2, which
drawings state, allows of the smallest lengths."""
TOLERANCES_MM = (0.001, 1.0)
"""Tolerances that may be asked for [mm]."""
_ORIGINS = ("center", "file")
MAX_BYTES = 50 << 20
"""Limit of a STEP file: a hundred times the largest of the sensors that we know, whose 271 faces
take 0.5 MiB; the CAD kernel needs some 30 times the size of a file."""
MAX_PARTS = 1_000
"""Bodies and assemblies of a file, each counted as often as it is placed: of a sensor that is
assembled with its housing, screws and all."""
_ENTITY = re.compile(
    rb"#(\d+)\s*=\s*(NEXT_ASSEMBLY_USAGE_OCCURRENCE|MAPPED_ITEM|REPRESENTATION_MAP"
    rb"|\w*SHAPE_REPRESENTATION)\s*\(([^;]*);"
)
_REFERENCE = re.compile(rb"#(\d+)")


def part_faces(path: Path | str, body: str = "", unit: str = "") -> PartFaces:
    """Faces of the body in a file, numbered, in the file's own frame, triangles and tets in
    millimetres.

    Raises InputError for a file without exactly one body, or one of the name or number ``body``.
    """
    path = Path(path)
    with naming(path):
        kind = _kind(path)
        if kind == "step":
            return _by_kernel(str(path), "faces_of_step", require_step_file(path), body)
        from taccel_lab.cad.gel_import.triangle_gel import faces_of_cells

        return faces_of_cells(path, kind, body, unit)


def import_gel(path: Path | str, selection: FaceSelection | None = None) -> ImportedGel:
    """Read, check and label a gel.

    Raises InputError for a file without exactly one closed, clean body of a gel's size, and for
    selectors that choose nothing, overlap or leave a region empty; the message lists the faces.
    """
    path, selection = Path(path), selection or FaceSelection()
    with naming(path):
        require_known("origin", selection.origin, _ORIGINS)
        kind = _kind(path)
        if kind == "step":
            gel = _by_kernel(str(path), "gel_of_step", require_step_file(path), selection)
        else:
            from taccel_lab.cad.gel_import.triangle_gel import gel_of_cells

            gel = gel_of_cells(path, kind, selection)
        if not selection.thickness_mm:
            return gel
        from taccel_lab.cad.gel_import.thickness import with_thickness

        return with_thickness(gel, selection.thickness_mm)


@dataclass(frozen=True)
class WorkshopSolid:
    """What moulds and drawings are made of."""

    solid: LabelledSolid
    faceted: str = ""
    """How the solid stands for the triangles of the file, in words; empty for the file's own."""
    deviation: dict[str, float] = field(default_factory=dict)
    """Figures of a solid that was simplified: triangles before and after, distance, tolerance."""


def workshop_solid(gel: ImportedGel, tolerance_mm: float = TOLERANCE_MM) -> WorkshopSolid:
    """The solid that moulds and drawings are made of: the file's own, or one of plane faces for
    triangles, simplified within ``tolerance_mm`` where they are more than ``MAX_FACETS``.

    Raises InputError where the tolerance cannot be held, and where the kernel makes no solid.
    """
    if gel.part is not None:
        return WorkshopSolid(gel.part)
    count = len(gel.surface.triangles)
    if count <= MAX_FACETS:
        solid = _by_kernel(gel.name, "facet_solid", gel.surface)
        return WorkshopSolid(solid, f"faces of the file's {count:,} triangles")
    from taccel_lab.cad.gel_import.triangle_gel import with_window, without_window
    from taccel_lab.cad.mesh.simplify import simplified

    require_range("tolerance_mm", tolerance_mm, *TOLERANCES_MM, "mm")
    # The window's rectangle is no shape: it would vanish among the triangles of its plane.
    rectangle = rectangle_of(gel.selection.window)
    try:
        found = simplified(
            gel.surface if rectangle is None else without_window(gel.surface),
            tolerance_mm,
            MAX_FACETS,
        )
    except InputError as error:
        raise InputError(
            f"{gel.name}: {error}. Allow more with --tolerance-mm, smooth or remesh the surface, "
            "or leave the workshop's files out with --parts"
        ) from None
    surface = found.surface if rectangle is None else with_window(found.surface, rectangle)
    words = (
        f"faces of {len(surface.triangles):,} triangles in place of the file's {count:,}; "
        f"Hausdorff distance of both surfaces {found.hausdorff_mm:.3f} mm, allowed "
        f"{tolerance_mm:g} mm"
    )
    figures = {
        "triangles": count,
        "simplified_triangles": len(surface.triangles),
        "hausdorff_mm": found.hausdorff_mm,
        "tolerance_mm": tolerance_mm,
    }
    return WorkshopSolid(_by_kernel(gel.name, "facet_solid", surface), words, figures)


def _kind(path: Path) -> str:
    """What a file holds: ``triangles``, ``tets`` or ``step``."""
    require_regular_file(path, triangle_file.MAX_BYTES, "a gel's file")
    # A link may be named by its digest, and so may the file that it leads to.
    names = (path, Path(os.path.realpath(path)))
    suffix = next((n.suffix.lower() for n in names if n.suffix.lower() in SUFFIXES), path.suffix)
    if suffix in triangle_file.SUFFIXES:
        return "triangles"
    if suffix in tet_file.SUFFIXES:
        return "tets"
    if suffix in STEP:
        return "step"
    raise InputError(f"{path}: a gel is read from {', '.join(SUFFIXES)}; not from {suffix!r}")


def _by_kernel(what: str, function: str, *arguments: Any) -> Any:
    """What a function of ``step_gel`` gives in the readers' process."""
    return read_apart(
        what, _of_step_gel, function, *arguments, by="OCP", limit_s=LIMIT_S,
        records=_faces if function == "faces_of_step" else _records,
    )  # fmt: skip


def _faces() -> tuple[type, ...]:
    return FaceInfo, FaceSelection, PartFaces, Region


def _records() -> tuple[type, ...]:
    # Solids are the kernel's, which this loads.
    from taccel_lab.cad.parts.part import LabelledSolid

    return (
        FaceInfo, FaceSelection, ImportedGel, LabelledSolid, LabelledSurface, PartFaces, Region,
    )  # fmt: skip


def _of_step_gel(function: str, *arguments: Any) -> Any:
    # Called in the readers' process: only there does the kernel load.
    from taccel_lab.cad.gel_import import step_gel

    return getattr(step_gel, function)(*arguments)


def require_step_file(path: Path) -> Path:
    """``path``, if a file lies there that the kernel may meet: it visits all parts that one places.

    Raises InputError for one that is too large, and for assemblies of assemblies that place more
    than ``MAX_PARTS``. Counted in the text by the entities of ISO 10303-44 (occurrences in
    assemblies) and 10303-43 (mapped items).
    """
    content = read_regular_file(path, MAX_BYTES, "a STEP file")
    parts: dict[Hashable, list[Hashable]] = {}
    placed: set[Hashable] = set()
    for number, kind, rest in _ENTITY.findall(content):
        names = _REFERENCE.findall(rest)
        if kind == b"NEXT_ASSEMBLY_USAGE_OCCURRENCE":
            parts.setdefault(b"".join(names[:1]), []).extend(names[1:2])
            placed.update(names[1:2])
        else:
            # A mapped item is of a map, a map of a representation, that one of what it lists.
            parts[number] = names[:1] if kind == b"MAPPED_ITEM" else names
            placed.update([number] if kind == b"MAPPED_ITEM" else [])
    inner = {name for names in parts.values() for name in names}
    roots = [name for name in parts if name not in inner]
    own = {name: int(name in placed) for name in (*parts, *inner)}
    require_few_copies(path, parts, roots, MAX_PARTS, own=own)
    return path
