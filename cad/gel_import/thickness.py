# SPDX-License-Identifier: Apache-2.0
"""An imported gel made thicker or thinner, as a mould does whose lid closes higher or lower.

The glued surface moves along the normal, as it is, plane or curved; contact face and the outline
at the glue stay. Stretching the whole body would change every radius of the contact face as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.bodies.mesh_checks import check_surface
from taccel_lab.cad.gel_import.gel_checks import check_gel
from taccel_lab.cad.gel_import.importer import ImportedGel
from taccel_lab.cad.mesh.mesh_pad import THICKNESSES_MM
from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.guards import require_range

_SAME_MM = 1e-6


def with_thickness(gel: ImportedGel, thickness_mm: float) -> ImportedGel:
    """The gel with its glued surface moved so that it is ``thickness_mm`` thick.

    Solid and tets of its file, which are of another thickness, are left out. Raises InputError
    where the glued surface would touch or cross another one.
    """
    require_range("thickness_mm", thickness_mm, *THICKNESSES_MM, "mm")
    away = thickness_mm - gel.thickness_mm
    if abs(away) < _SAME_MM:
        return gel
    surface = gel.surface
    glued = np.unique(surface.of(Region.BOND, Region.WINDOW))
    points = surface.vertices_mm.copy()
    points[glued, 2] -= away
    moved = LabelledSurface(points, surface.triangles, surface.regions)
    try:
        least = _checked(moved)
    except InputError as error:
        raise InputError(
            f"the gel of {gel.name} cannot be {thickness_mm:g} mm thick: with its glued surface "
            f"moved by {away:+.3f} mm, {error}; the file's gel is {gel.thickness_mm:.3f} mm thick"
        ) from None
    words = (
        f"{thickness_mm:g} mm in place of the file's {gel.thickness_mm:.3f} mm: the glued surface "
        f"is moved by {away:+.3f} mm, contact face and outline stay"
    )
    return replace(
        gel,
        surface=moved,
        min_thickness_mm=least,
        assumed=gel.assumed | {"thickness": words},
        part=None,
        mesh=None,
    )


def _checked(surface: LabelledSurface) -> float:
    """Least thickness [mm] of a surface that is moved; InputError where it is no gel's."""
    try:
        check_surface(surface.vertices_mm, surface.triangles, "", closed=True)
    except InputError:
        # Its words are of vertices and faces that the user's file does not number so.
        raise InputError("it touches or crosses the rest of the gel") from None
    if surface.volume_mm3() <= 0:
        raise InputError("it lies beyond the contact face")
    return check_gel(surface)
