# SPDX-License-Identifier: Apache-2.0
"""Dome pads: dimensions of real sensors, closed forms, solids and their labels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dome_strategies import DIGIT_360, GEL_TIP, R_TAC, domes
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.dome_pad import DomePad, ShellDomePad, SolidDomePad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region


def test_digit_360_as_measured() -> None:
    figures = DIGIT_360.figures()
    assert figures["total_height"] == pytest.approx(26.0)
    assert figures["base_diameter"] == pytest.approx(25.0)
    # Measured on the part: 10534.8 mm3, cone from 4.927 to 4.879 mm, torus 4.629 / 0.25 mm.
    assert labelled_solid(DIGIT_360).volume_mm3 == pytest.approx(10534.8, rel=1e-4)
    wall, fillet, _ = DIGIT_360.meridian.of(Region.WINDOW)
    assert wall.point(np.ones(()))[0] == pytest.approx(4.879, abs=5e-4)
    assert fillet.point(np.array([0.0, 1.0]))[1, 1] == pytest.approx(-26 + 1.55)
    assert DIGIT_360.thickness_mm == pytest.approx(26 - figures["pocket_depth_at_axis"])


def test_shells_of_r_tac_and_gel_tip_by_closed_form() -> None:
    sphere = 2 / 3 * np.pi * (15**3 - 13.5**3)
    assert R_TAC.meridian.volume_mm3() == pytest.approx(sphere)
    assert R_TAC.meridian.area_mm2(Region.WINDOW) == pytest.approx(2 * np.pi * 13.5**2 * 0.5)
    assert R_TAC.meridian.area_mm2(Region.CONTACT) == pytest.approx(2 * np.pi * 15**2)
    with_skirt = 2 / 3 * np.pi * (11.5**3 - 9.5**3) + np.pi * (11.5**2 - 9.5**2) * 10
    assert GEL_TIP.meridian.volume_mm3() == pytest.approx(with_skirt)
    assert GEL_TIP.meridian.area_mm2(Region.SIDE) == pytest.approx(2 * np.pi * 11.5 * 10)
    np.testing.assert_allclose(GEL_TIP.bounds_mm(), [[-11.5, -11.5, -21.5], [11.5, 11.5, 0]])


@given(domes())
@settings(max_examples=60, deadline=None)
def test_the_meridian_is_a_closed_chain_from_axis_to_axis(pad: DomePad) -> None:
    assert pad.meridian.gap_mm() < 1e-9
    pieces = pad.meridian.pieces
    np.testing.assert_allclose(pieces[0].point(np.zeros(())), [0, 0], atol=1e-12)
    end = pieces[-1].point(np.ones(()))
    np.testing.assert_allclose(end, [0, -pad.thickness_mm], atol=1e-9)
    low, high = pad.bounds_mm()
    for piece in pieces:
        points = piece.point(np.linspace(0, 1, 50))
        assert points[:, 1].min() >= low[2] - 1e-9 and points[:, 1].max() <= high[2] + 1e-9
        assert points[:, 0].max() <= high[0] + 1e-9
    areas = [pad.meridian.area_mm2(r) for r in (Region.CONTACT, Region.BOND, Region.WINDOW)]
    assert min(areas) > 0


@given(domes(), st.floats(0, 0.99), st.floats(-np.pi, np.pi))
@settings(max_examples=60, deadline=None)
def test_top_and_normal_are_those_of_the_sphere(pad: DomePad, share: float, turn: float) -> None:
    xy = share * pad.cap_radius_mm * np.array([np.cos(turn), np.sin(turn)])
    point = np.append(xy, pad.top_mm(xy))
    assert pad.contact_error_mm(point[None])[0] < 1e-9
    center = np.array([0, 0, -pad.dome_radius_mm])
    np.testing.assert_allclose(pad.top_normal(xy), (point - center) / pad.dome_radius_mm, atol=1e-9)
    outside = xy / max(share, 1e-9) * 1.01
    if share > 1e-3:
        assert np.isnan(pad.top_mm(outside)) and np.isnan(pad.top_normal(outside)).all()


@given(domes(), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_bond_projection_is_idempotent_and_lands_on_glued_pieces(pad: DomePad, seed: int) -> None:
    low, high = pad.bounds_mm()
    points = np.random.default_rng(seed).uniform(low, high, (50, 3))
    landed = pad.bond_projection_mm(points)
    np.testing.assert_allclose(pad.bond_projection_mm(landed), landed, atol=1e-9)
    rz = np.stack([np.hypot(landed[:, 0], landed[:, 1]), landed[:, 2]], axis=1)
    glued = pad.meridian.of(Region.BOND, Region.WINDOW)
    off = np.min([np.linalg.norm(p.closest(rz) - rz, axis=1) for p in glued], axis=0)
    assert off.max() < 1e-9


@pytest.mark.parametrize(
    "pad",
    [
        DIGIT_360,
        R_TAC,
        GEL_TIP,
        SolidDomePad(bonded_wall_mm=4),
        ShellDomePad(opening_deg=55, window_deg=35, rim="free", thickness_mm=3),
    ],
)
def test_solids_have_the_volume_and_the_labelled_areas_of_the_meridian(pad: DomePad) -> None:
    part = labelled_solid(pad)
    assert part.solid.is_valid
    assert part.volume_mm3 == pytest.approx(pad.meridian.volume_mm3(), rel=1e-5)
    for region in Region:
        wanted = pad.meridian.area_mm2(region)
        assert part.area_mm2(region) == pytest.approx(wanted, rel=1e-6, abs=1e-9)
    surface = tessellate_solid(part, tolerance_mm=0.01, angle_rad=0.1)
    assert surface.volume_mm3() == pytest.approx(part.volume_mm3, rel=0.01)
    centers = surface.vertices_mm[surface.triangles].mean(axis=1)
    agree = pad.region_of(centers) == surface.regions
    assert (surface.areas_mm2() * agree).sum() > 0.99 * surface.areas_mm2().sum()


@pytest.mark.parametrize(
    ("make", "values", "word"),
    [
        (SolidDomePad, {"dome_radius_mm": 2}, "dome_radius_mm = 2 is below"),
        (SolidDomePad, {"bonded_wall_mm": 13.4}, "bonded_wall_mm = 13.4 leaves less"),
        (SolidDomePad, {"pocket_radius_mm": 12}, "too narrow a base"),
        (SolidDomePad, {"pocket_dome_radius_mm": 4}, "no room for its wall"),
        (SolidDomePad, {"pocket_edge_radius_mm": 3}, "no room for its wall"),
        (
            SolidDomePad,
            {"pocket_depth_mm": 24.5, "pocket_taper_deg": 0, "pocket_radius_mm": 3},
            "leaves .* of gel under the apex",
        ),
        (
            SolidDomePad,
            {"pocket_depth_mm": 22, "pocket_radius_mm": 10, "pocket_dome_radius_mm": 200},
            "comes within .* of the contact face",
        ),
        (ShellDomePad, {"thickness_mm": 14}, "leaves a core"),
        (ShellDomePad, {"opening_deg": 60, "skirt_mm": 3}, "needs a hemisphere"),
        (ShellDomePad, {"opening_deg": 60, "window_deg": 70}, "does not fit a cap"),
        (ShellDomePad, {"rim": "free"}, "nothing but the window is glued"),
        (ShellDomePad, {"rim": "loose"}, "one of bonded, free"),
    ],
)
def test_what_cannot_be_built_says_so(make: Any, values: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=word):
        make(**values)
