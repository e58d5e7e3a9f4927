# SPDX-License-Identifier: Apache-2.0
"""Does a gel's mesh have the size that its block states, or was a unit of length mistaken?"""

from __future__ import annotations

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh

TOLERANCE = 0.1
"""Of the thickness: chords of a coarse mesh miss a curved face by some per cent, a wrong unit by a
factor of 25 or more."""
MAX_EXTENT_MM = 1000.0
"""Largest extent of a gel along an axis; the largest that the catalogue's bounds allow has 160."""
_SLIPS = {
    1e3: "its coordinates look like millimetres, where metres belong",
    1e6: "its coordinates look like micrometres, where metres belong",
    1 / 25.4e-3: "its coordinates look like inches, where metres belong",
    1e-3: "its coordinates look like metres that were taken for millimetres",
    1e-6: "its coordinates look like metres that were taken for micrometres",
}
"""Times too large -> what went wrong."""


def check_mesh_size(mesh: TetMesh, thickness_mm: float) -> None:
    """Refuse a mesh without touched or glued faces, or of another size than the gel's block.

    The thickness is that of the gel under the apex, so it lies between the depth of the highest
    glued point and that of the lowest point of all: the same in a pad with a flat back, while a
    dome's glued wall or its skirt may reach farther up or down.
    """
    z_mm = mesh.nodes_m[:, 2] * 1e3
    contact, glued = mesh.region_nodes(Region.CONTACT), mesh.bonded_nodes()
    for nodes, name in ((contact, "contact"), (glued, "bond or window")):
        if not len(nodes):
            raise InputError(f"the mesh has no {name} faces; a gel needs some")
    apex = z_mm[contact].max()
    least, most = float(apex - z_mm[glued].max()), float(apex - z_mm.min())
    if _agrees(least, most, thickness_mm):
        extent = float(1e3 * (mesh.nodes_m.max(axis=0) - mesh.nodes_m.min(axis=0)).max())
        if extent > MAX_EXTENT_MM:
            raise InputError(
                f"the mesh is {extent:g} mm large; up to {MAX_EXTENT_MM:g} mm are allowed"
            )
        return
    found = f"{most:.4g} mm" if most - least < TOLERANCE * most else f"{least:.4g} to {most:.4g} mm"
    why = "".join(
        f". It is {max(factor, 1 / factor):,.0f} times too {'large' if factor > 1 else 'small'}: "
        f"{words}"
        for factor, words in _SLIPS.items()
        if _agrees(least / factor, most / factor, thickness_mm)
    )
    raise InputError(
        f"the mesh has {found} of gel under its apex, gel.thickness_mm says {thickness_mm:g} mm; "
        f"they must agree within {TOLERANCE:.0%}{why}"
    )


def _agrees(least: float, most: float, thickness: float) -> bool:
    return bool(least <= thickness * (1 + TOLERANCE) and thickness <= most * (1 + TOLERANCE))
