# SPDX-License-Identifier: Apache-2.0
"""A sensor's parts for the workshop, put together."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taccel_lab.geometry import Region
from taccel_lab.sensors.base import FamilyParameters, all_optics

if TYPE_CHECKING:
    from build123d import Face, Solid

    from taccel_lab.cad.assembly import Assembly
    from taccel_lab.cad.parts.pad import Pad
    from taccel_lab.cad.parts.part import LabelledSolid, Part

_ON_FACE_MM = 1e-3
_GRID = (0.011, 0.27, 0.51, 0.73, 0.989)
_LAYER_COLORS = {"gel": (0.93, 0.80, 0.62), "skin": (0.25, 0.25, 0.27)}


def sensor_parts(
    name: str, parameters: FamilyParameters, gel: LabelledSolid | None = None
) -> Assembly:
    """The assembly of a sensor; ``gel`` is the solid of its pad if it is already at hand.

    Raises InputError when a part cannot be built, naming the bound that is broken.
    """
    from taccel_lab.cad.assembly import sensor_assembly
    from taccel_lab.cad.parts.pad_solid import labelled_solid

    pad, optics = parameters.pad(), parameters.optics()
    gel = gel or labelled_solid(pad)
    return sensor_assembly(
        name,
        gel_parts(pad, gel),
        pad.thickness_mm,
        window=None if optics is None else optics.window,
        housing=parameters.housing(),
        cameras=tuple(design.camera for design in all_optics(parameters)),
        leds=() if optics is None else optics.lights,
        view_mm=_view_mm(gel),
    )


def gel_parts(pad: Pad, gel: LabelledSolid) -> tuple[Part, ...]:
    """The gel as one part, or its layers as a part each, core first."""
    from taccel_lab.cad.parts.part import Part, gel_part

    layers = gel_layers(pad, gel)
    if len(layers) < 2:
        return (gel_part(gel),)
    return tuple(
        Part(
            name=name,
            solid=layer.solid,
            face_names=tuple(region.name.lower() for region in layer.regions),
            color=_LAYER_COLORS.get(name, (0.6, 0.6, 0.6)),
            material=f"silicone, {name}",
            gel=True,
        )
        for name, layer in layers.items()
    )


def gel_layers(pad: Pad, gel: LabelledSolid) -> dict[str, LabelledSolid]:
    """The layers of the gel by name, core first; a face inside the gel counts as side."""
    from taccel_lab.cad.parts.pad_solid import layer_solids
    from taccel_lab.cad.parts.part import LabelledSolid

    names: list[str] = list(pad.layer_names)
    if len(names) == 1:
        return {names[0]: gel}
    layers = {name: _with_window(solid, gel) for name, solid in layer_solids(pad).items()}
    return {
        name: LabelledSolid(solid, [_region_of(face, gel) for face in solid.faces()])
        for name, solid in layers.items()
    }


def _with_window(layer: Solid, gel: LabelledSolid) -> Solid:
    """The layer with the gel's window drawn on a face that holds all of it."""
    from taccel_lab.cad.parts.solids import imprint

    for window in gel.faces(Region.WINDOW):
        for face in layer.faces():
            spare = face.area - window.area
            if spare > _ON_FACE_MM and face.distance_to(window.center()) < _ON_FACE_MM:
                return imprint(layer, face, window.outer_wire())
    return layer


def _region_of(face: Face, gel: LabelledSolid) -> Region:
    """Region of the face of the whole gel that a layer's face is a part of."""
    # A face may have a hole in its middle.
    grid = [(u, v) for u in _GRID for v in _GRID]
    points = [point for point in (face.position_at(*uv) for uv in grid) if face.is_inside(point)]
    for whole, region in zip(gel.solid.faces(), gel.regions, strict=True):
        if points and all(whole.distance_to(point) < _ON_FACE_MM for point in points):
            return region
    return Region.SIDE


def _view_mm(gel: LabelledSolid) -> tuple[float, float]:
    """Extents of the gel's window face in plan [mm]."""
    boxes = [face.bounding_box() for face in gel.faces(Region.WINDOW)]
    if not boxes:
        return (0.0, 0.0)
    return (
        max(b.max.X for b in boxes) - min(b.min.X for b in boxes),
        max(b.max.Y for b in boxes) - min(b.min.Y for b in boxes),
    )
