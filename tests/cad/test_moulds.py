# SPDX-License-Identifier: Apache-2.0
"""Moulds hold the gel's volume plus their stated draft, close, and let go of the gel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from build123d import Axis, Plane, Pos, Solid

from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.moulds import Mould, MouldOptions, casting_moulds, check_mould, gel_mould
from taccel_lab.cad.moulds.two_part import place_gates
from taccel_lab.cad.parts.dome_pad import ShellDomePad, SolidDomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.pad_solid import labelled_solid, layer_solids
from taccel_lab.cad.parts.part import LabelledSolid
from taccel_lab.cad.parts.solids import common_volume_mm3, rounded_rectangle
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from tests.support.sensor_refusals import refuses
from tests.support.variants import variants

CROWNED = GelPad(crown_radius_x_mm=50.0, crown_radius_y_mm=50.0, thickness_mm=5.0)
PADS = {
    "crowned": CROWNED,
    "fillet": GelPad(thickness_mm=4.0, rim="fillet", rim_mm=0.8),
    "shell": ShellDomePad(skirt_mm=5.0),
    "dome": SolidDomePad(),
}


@pytest.fixture(scope="module")
def crowned() -> tuple[LabelledSolid, Mould]:
    gel = labelled_solid(CROWNED)
    return gel, gel_mould(gel)


def flat_back(solid: Solid) -> LabelledSolid:
    """A solid whose lowest face is glued."""
    low = solid.bounding_box().min.Z + 1e-4
    glued = [face.bounding_box().max.Z < low for face in solid.faces()]
    return LabelledSolid(solid, [Region.BOND if g else Region.SIDE for g in glued])


@pytest.mark.thorough
@pytest.mark.parametrize("name", variants(["dome"], PADS))
def test_cavity_is_the_gel_plus_shrinkage_plus_draft(name: str) -> None:
    gel = labelled_solid(PADS[name])
    mould = gel_mould(gel, MouldOptions(draft_deg=3.0, shrinkage_percent=0.5))
    report, body = check_mould(mould, gel), mould.body
    width, height = report.draft_width_mm, report.draft_height_mm
    assert width == pytest.approx(math.tan(math.radians(3)) * height)
    # All outlines are convex, so that Steiner's formula gives the wedge.
    # An outline of perimeter P grown by s covers P s + pi s^2 more; s falls to 0 at the top.
    width = body.draft_width_mm
    wedge = body.draft_height_mm * (body.outline.length * width / 2 + np.pi * width**2 / 3)
    expected = gel.volume_mm3 / 0.995**3 + wedge
    assert report.draft_volume_mm3 == pytest.approx(wedge, rel=1e-4)
    assert report.cavity_volume_mm3 == pytest.approx(expected, rel=1e-5)
    assert report.undercut_mm2 < 0.05 and report.overlap_mm3 < 1e-6
    assert mould.cavity.solid.is_valid and mould.lid.solid.is_valid


@pytest.mark.thorough
def test_no_shrinkage_and_no_draft_give_the_gel_itself() -> None:
    gel = labelled_solid(CROWNED)
    report = check_mould(gel_mould(gel, MouldOptions(draft_deg=0.0, shrinkage_percent=0.0)), gel)
    assert report.cavity_volume_mm3 == pytest.approx(gel.volume_mm3, rel=1e-6)
    assert report.vertical_mm == pytest.approx(5 - (50 - math.sqrt(50**2 - 10**2)), abs=1e-6)


@pytest.mark.thorough
def test_cavity_has_the_contact_face_and_a_lid(crowned: tuple[LabelledSolid, Mould]) -> None:
    gel, mould = crowned
    faces = [f for f in mould.cavity.faces("mould") if f.center().Z > -0.9]
    scale = 1 / (1 - mould.options.shrinkage_percent / 100)
    wanted = gel.area_mm2(Region.CONTACT) * scale**2
    assert sum(face.area for face in faces) == pytest.approx(wanted, rel=1e-6)
    solid = mould.cavity.solid
    regions = [Region.CONTACT if face in faces else Region.SIDE for face in solid.faces()]
    surface = tessellate_solid(LabelledSolid(solid, regions))
    contact = surface.triangles[surface.regions == Region.CONTACT]
    points = surface.vertices_mm[np.unique(contact)] / scale
    np.testing.assert_allclose(points[:, 2], CROWNED.crown_mm(points[:, :2]), atol=1e-5)
    # Pins locate the lid one way round.
    cavity, lid, base = mould.cavity.solid, mould.lid.solid, mould.body.base_z_mm
    assert common_volume_mm3(cavity, lid) < 1e-6
    assert common_volume_mm3(cavity, lid.rotate(Axis.Z, 180)) > 1.0
    top = lid.bounding_box().max
    assert top.Z == pytest.approx(base + 6.0)
    # 0.1 mm beside the pins.
    probe, wider = (
        Solid.make_cylinder(radius, 5.0, Plane((top.X - 4.5, top.Y - 4.5, base)))
        for radius in (2.09, 2.2)
    )
    assert common_volume_mm3(cavity, probe) < 1e-6
    assert common_volume_mm3(cavity, wider) > 1.0


def test_gates_lead_through_the_lid_to_the_margin(crowned: tuple[LabelledSolid, Mould]) -> None:
    _, mould = crowned
    assert [gate.kind for gate in mould.gates] == ["pour", "vent", "vent", "vent"]
    base = mould.body.base_z_mm
    for gate in mould.gates:
        x, y = gate.at_mm
        to_window = math.hypot(max(abs(x) - 9.0, 0.0), max(abs(y) - 7.0, 0.0))
        assert to_window > gate.diameter_mm / 2, gate
        assert CROWNED.inside_distance_mm(np.array([x, y])) > gate.diameter_mm / 2
        bore = Solid.make_cylinder(gate.diameter_mm / 2 - 0.01, 20, Plane((x, y, base - 10)))
        assert common_volume_mm3(mould.lid.solid, bore) < 1e-6


@pytest.mark.thorough
def test_a_planted_undercut_is_refused_with_its_place(crowned: tuple[LabelledSolid, Mould]) -> None:
    """A groove round the wall holds the gel in the cavity."""
    slit = Pos(0, 0, -3.5) * Solid.make_box(30, 30, 0.5, Plane((-15, -15, 0)))
    slit = slit.cut(Pos(0, 0, -4) * Solid.make_box(23, 19, 2, Plane((-11.5, -9.5, 0))))
    gel = flat_back(crowned[0].solid.cut(slit).solids()[0])
    with pytest.raises(InputError, match=r"undercut of .* z -3\.0.* cannot let go"):
        check_mould(gel_mould(gel), gel)


@pytest.mark.thorough
def test_skin_is_cast_over_the_core() -> None:
    pad = GelPad(thickness_mm=2.8, skin_top_mm=0.3, skin_side_mm=1.4)
    layers = {name: flat_back(solid) for name, solid in layer_solids(pad).items()}
    (first, core), (second, skin) = casting_moulds(labelled_solid(pad), layers)
    assert [first.name, second.name] == ["mould_1_gel", "mould_2_skin"]
    assert core.gel_volume_mm3 == pytest.approx(layers["gel"].volume_mm3)
    expected = layers["skin"].volume_mm3 / 0.999**3 + skin.draft_volume_mm3
    assert skin.fill_mm3 == pytest.approx(expected, rel=1e-4)
    # The holes of the second mould open over the skin, not over the core.
    half = np.array([24.0, 20.0]) / 2 - 1.4
    for gate in second.gates:
        assert (np.abs(gate.at_mm) > half - 1e-3).any()


def cast_cone() -> None:
    cone = Solid.make_cone(8.0, 10.0, 4.0)
    gel_mould(LabelledSolid(cone, [Region.SIDE] * len(cone.faces())))


def pour_into_ring() -> None:
    ring = rounded_rectangle((10.0, 10.0), 1.0).cut(rounded_rectangle((9.4, 9.4), 0.7))
    place_gates(ring.faces(), pour_mm=3, vent_mm=1, vents=3)


test_what_cannot_be_cast_is_refused = refuses(
    lambda make: make(),
    (lambda: MouldOptions(draft_deg=11), "draft_deg = 11 is above"),
    (lambda: MouldOptions(wall_mm=2), "wall_mm = 2 is below"),
    (lambda: MouldOptions(shrinkage_percent=-1), "shrinkage_percent"),
    (cast_cone, r"juts out 2\.0\d* mm"),
    (pour_into_ring, r"pour hole of 0\.1\d mm only"),
    pytest.param(
        (
            lambda: gel_mould(labelled_solid(CROWNED), MouldOptions(pin_mm=8.0, wall_mm=6.0)),
            "pin_mm = 8 .* allowed: up to 4 mm",
        ),
        marks=pytest.mark.thorough,
    ),
)
