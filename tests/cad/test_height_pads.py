# SPDX-License-Identifier: Apache-2.0
"""Pads of real sensors against what was measured of them, and what cannot be built."""

from __future__ import annotations

import numpy as np
import pytest
from build123d import import_step
from catalogue_pads import BEVELLED, DIGIT, MINI, SKINNED
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.closest import ClosestPoint, surface_samples
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.digit_pad import DigitPad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad_solid import labelled_solid, layer_solids
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from tests.support.real_data import real_data


def test_mini_lies_on_the_measured_gel() -> None:
    step = real_data("sensor_geometry/gelsight_mini/gelsight_mini_gel_feats.step")
    vertices, triangles = import_step(str(step)).solids()[0].tessellate(0.005, 0.05)
    flange_mm, offset_x_mm, offset_z_mm = 19.25, 0.25, 0.5
    raw = np.array([tuple(v) for v in vertices])
    measured = np.stack(
        [raw[:, 0] + offset_x_mm, raw[:, 2] + offset_z_mm, raw[:, 1] - flange_mm - 4.0], axis=1
    )
    ours = tessellate_solid(labelled_solid(MINI), tolerance_mm=0.005, angle_rad=0.1)
    here = surface_samples(ours.vertices_mm, ours.triangles, 8000)
    away, _ = ClosestPoint(measured, np.array(triangles))(here)
    assert away.max() < 0.1
    assert np.sqrt((away**2).mean()) < 0.02


@given(st.floats(16, 200), st.floats(3.5, 6), st.floats(0.3, 1.2))
@settings(max_examples=20, deadline=None)
def test_digit_sections_have_the_wanted_sag(radius: float, thickness: float, roll: float) -> None:
    pad = DigitPad(mid_radius_mm=radius, thickness_mm=thickness + 2, roll_off=roll, rim_mm=0.0)
    ends = pad.height_mm(np.array([[0.0, 0.0], [9.2, 0.0]]))
    # The polynomial's section drops 2.0595 mm where an arc of 21.4 mm drops 2.0784 mm.
    sag = radius - np.sqrt(radius**2 - 9.2**2)
    assert ends[0] - ends[1] == pytest.approx(sag * 2.0595 / 2.0784, rel=1e-3)
    y = np.linspace(-12.5, 12.5, 400)
    line = pad.height_mm(np.stack([np.zeros(400), y], axis=1))
    assert line.max() == pytest.approx(0, abs=1e-4)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_fillets_are_the_envelope_of_balls_that_fit(seed: int) -> None:
    """The top is as high as the highest ball under crown and wall, searched by brute force."""
    rng = np.random.default_rng(seed)
    length = rng.uniform(0, DIGIT.outline.perimeter_mm)
    edge, normal = DIGIT.outline.at_mm(np.array([length]))
    p = (edge - rng.uniform(0.02, 0.85) * normal)[0]
    r = DIGIT.rim_mm
    disc = r * np.sqrt(rng.uniform(0, 1, (20000, 1)))
    turn = rng.uniform(0, 2 * np.pi, (20000, 1))
    disc = disc * np.concatenate([np.cos(turn), np.sin(turn)], axis=1)
    s = np.linspace(-0.5, 0.5, 101) + length
    on_edge, normals = DIGIT.outline.at_mm(s)
    centers = on_edge - r * normals
    reach = r**2 - ((p - centers) ** 2).sum(axis=1)
    best = -np.inf
    for center, left in zip(centers, reach, strict=True):
        if left < 0:
            continue
        under = DIGIT.crown_mm(center + disc) - np.sqrt(r**2 - (disc**2).sum(axis=1))
        best = max(best, float(under.min() + np.sqrt(left)))
    found = float(DIGIT.height_mm(p))
    crown = float(DIGIT.crown_mm(p))
    if found < crown:
        assert best == pytest.approx(found, abs=4e-3)
    else:
        # Beyond the fillet the crown itself is the top: a ball touching it there fits inside.
        assert found == crown and best < found + 1e-9
        g = DIGIT.crown_slope(p)
        assert DIGIT.inside_distance_mm(p + r * g / np.sqrt(1 + (g**2).sum())) >= r


def test_skin_and_core_have_the_volumes_of_their_prisms() -> None:
    solids = layer_solids(SKINNED)
    corners = 4 - np.pi
    core = (29.5 * 22.5 - corners * 1.0**2) * 2.5
    whole = (31.1 * 24.1 - corners * 1.8**2) * 2.8
    assert SKINNED.layer_names == ("gel", "skin") == tuple(solids)
    assert solids["gel"].volume == pytest.approx(core, rel=1e-9)
    assert solids["skin"].volume == pytest.approx(whole - core, rel=1e-9)
    assert MINI.layer_names == ("gel",) == tuple(layer_solids(MINI))
    points = np.array([[0, 0, -0.2], [0, 0, -0.4], [15.0, 0, -2.0], [14.0, 0, -2.0]])
    np.testing.assert_array_equal(SKINNED.layer_of(points), [1, 0, 1, 0])


def test_glued_walls_are_bond() -> None:
    part = labelled_solid(BEVELLED)
    assert part.area_mm2(Region.SIDE) == 0
    perimeter = BEVELLED.outline.perimeter_mm
    back = BEVELLED.outline.area_mm2 - BEVELLED.window_x_mm * BEVELLED.window_y_mm
    assert part.area_mm2(Region.BOND) == pytest.approx(back + perimeter * 2.971, rel=1e-3)
    points = np.array([[19.9, 0, -3.5], [0, 0, -5.8], [10.0, 19.99, -5.0]])
    moved = BEVELLED.bond_projection_mm(points)
    np.testing.assert_allclose(moved, [[20, 0, -3.5], [0, 0, -5.925], [10, 20, -5.0]])


@pytest.mark.parametrize(
    ("pad", "values", "words"),
    [
        (MINI, {"wall_mm": 3.9}, ["wall_mm = 3.9", "0.3 to 3.6"]),
        (MINI, {"rim_radius_mm": 3.2}, ["rim_radius_mm = 3.2", "at least 3.40935"]),
        (MINI, {"rim_mm": 9}, ["rim_mm = 9", "up to 8.3"]),
        (BEVELLED, {"crown_radius_x_mm": 200}, ["wall_mm", "flat contact face"]),
        (SKINNED, {"skin_mm": 0}, ["skin_side_mm = 0.8", "skin_mm"]),
        (SKINNED, {"skin_mm": 2.7}, ["skin_mm = 2.7", "up to 2.5"]),
        (SKINNED, {"skin_side_mm": 1.7}, ["skin_side_mm = 1.7", "up to 1.62"]),
        (SKINNED, {"rim": "fillet"}, ["rim none, chamfer or arc"]),
        (SKINNED, {"window_x_mm": 29.4}, ["window_x_mm", "at least 0.2 mm"]),
        (DIGIT, {"rim_mm": 1.3}, ["rim_mm = 1.3", "up to 1.17"]),
        (DIGIT, {"mid_radius_mm": 10}, ["mid_radius_mm = 10", "at least 11.96"]),
        (DIGIT, {"length_mm": 11}, ["length_mm = 11", "at least 11.5"]),
        (DIGIT, {"thickness_mm": 2.5}, ["of wall", "thickness_mm must be at least"]),
        (DIGIT, {"window_y_mm": 22}, ["window_x_mm", "at least 0.2 mm"]),
        (DIGIT, {"roll_off": 3}, ["roll_off = 3", "0 to 2"]),
    ],
)
def test_what_cannot_be_built_names_its_bound(
    pad: HeightPad, values: dict[str, object], words: list[str]
) -> None:
    with pytest.raises(InputError) as error:
        pad.with_values(values)
    for word in words:
        assert word in str(error.value)


def test_a_pillowed_crown_with_equal_drops_has_level_edges() -> None:
    pad = GelPad(crown_radius_x_mm=1440, crown_radius_y_mm=1000, crown_pillow=1.0)
    x = np.linspace(-12, 12, 9)
    edge = pad.crown_mm(np.stack([x, np.full(9, 10.0)], axis=1))
    np.testing.assert_allclose(edge, -0.05, atol=1e-4)
