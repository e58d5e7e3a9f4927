# SPDX-License-Identifier: Apache-2.0
"""One door to the structured meshers: the mesh of any pad, even or fine around a contact.

Structured meshes keep their connectivity over every change of a pad's dimensions, and their size is
known beforehand, so that a sweep over designs is one batch of environments.
"""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.mesh.contact_plan import ContactOutline
from taccel_lab.cad.mesh.dome import even_dome_mesh, focused_dome_mesh
from taccel_lab.cad.mesh.even import even_gel_mesh
from taccel_lab.cad.mesh.structured import structured_gel_mesh
from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh

DEFAULT_EDGE_MM = 1.0
DOME_RINGS = 4
"""Rings that a dome needs beyond those of a pad: from the apex to its edge it is twice as far."""


@dataclass(frozen=True)
class FocusOptions:
    """Where and how finely a mesh resolves a contact; counts alone set the connectivity."""

    at_mm: tuple[float, float]
    """Gel xy of the contact."""
    radius_mm: float
    """Radius of the fine part."""
    size_mm: float
    """Element size in the fine part."""
    core: int = 12
    rings: int = 20
    layers: int = 4
    layer_ratio: float = 1.5
    """Thickness of a layer over that of the one above it, at the contact."""
    outlines: tuple[ContactOutline, ContactOutline] | None = None
    """What the rings follow around the contact instead of circles, at the contact face and at the
    back; on a dome in the plane that touches it there."""
    lean: float = 1.0
    """Power of the depth by which columns lean from the face's plan to the back's; above 1 they
    are steeper where the layers are thin."""


def gel_mesh(
    pad: Pad, edge_mm: float = DEFAULT_EDGE_MM, *, counts_of: Pad | None = None
) -> TetMesh:
    """Structured mesh of ``pad`` whose elements are about ``edge_mm`` long.

    ``counts_of`` names the pad whose dimensions choose how many cells there are: with the same one
    every pad of a sweep has the same connectivity. So far for pads with a flat back.
    """
    if isinstance(pad, HeightPad) and (counts_of is None or isinstance(counts_of, HeightPad)):
        return even_gel_mesh(pad, edge_mm, counts_of=counts_of)
    if counts_of is not None:
        raise InputError(
            f"counts_of: {type(pad).__name__} cannot have the cell counts of "
            f"{type(counts_of).__name__}; both must be pads with a flat back"
        )
    if isinstance(pad, DomePad):
        return even_dome_mesh(pad, edge_mm)
    raise InputError(f"no structured mesher for {type(pad).__name__}; use the mesher tetwild")


def focused_gel_mesh(pad: Pad, focus: FocusOptions) -> TetMesh:
    """Structured mesh of ``pad``, fine around a contact, of the same connectivity anywhere."""
    if isinstance(pad, HeightPad):
        return structured_gel_mesh(
            pad,
            focus_mm=focus.at_mm,
            focus_radius_mm=focus.radius_mm,
            focus_size_mm=focus.size_mm,
            core=focus.core,
            rings=focus.rings,
            layers=focus.layers,
            layer_ratio=focus.layer_ratio,
            outlines=focus.outlines,
            lean=focus.lean,
        )
    if isinstance(pad, DomePad):
        return focused_dome_mesh(
            pad,
            focus_mm=focus.at_mm,
            focus_radius_mm=focus.radius_mm,
            focus_size_mm=focus.size_mm,
            core=focus.core,
            rings=focus.rings + DOME_RINGS,
            layers=focus.layers,
            outlines=focus.outlines,
            layer_ratio=focus.layer_ratio,
        )
    raise InputError(f"no focused mesher for {type(pad).__name__}")
