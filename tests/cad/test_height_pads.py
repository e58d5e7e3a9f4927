# SPDX-License-Identifier: Apache-2.0
"""Pads with a plane back: formulas, solids, files and what was measured of real ones."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from build123d import import_step
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.export import dimensions, write_step
from taccel_lab.cad.mesh.closest import ClosestPoint, surface_samples
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.digit_pad import DigitPad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.pad_solid import labelled_solid, layer_solids
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from tests.cad.pads import BEVELLED, DIGIT, MINI, SKINNED
from tests.support.real_data import real_data
from tests.support.sensor_refusals import refuses

DOME: dict[str, Any] = {"crown_radius_x_mm": 50.0, "crown_radius_y_mm": 50.0, "thickness_mm": 5.0}


def test_crowns_by_differences_and_closed_form() -> None:
    pad = GelPad(crown_radius_x_mm=60, crown_radius_y_mm=90, thickness_mm=5)
    xy = np.random.default_rng(2).uniform(-9, 9, (50, 2))
    step = 1e-5
    for axis, shift in enumerate(step * np.eye(2)):
        numeric = (pad.crown_mm(xy + shift) - pad.crown_mm(xy - shift)) / (2 * step)
        np.testing.assert_allclose(pad.crown_slope(xy)[:, axis], numeric, atol=1e-9)
    # A pillowed crown with equal drops has level edges.
    pad = GelPad(crown_radius_x_mm=1440, crown_radius_y_mm=1000, crown_pillow=1.0)
    x = np.linspace(-12, 12, 9)
    edge = pad.crown_mm(np.stack([x, np.full(9, 10.0)], axis=1))
    np.testing.assert_allclose(edge, -0.05, atol=1e-4)


def test_thickness_named_in_the_error_is_enough() -> None:
    with pytest.raises(InputError) as error:
        GelPad(**{**DOME, "thickness_mm": 1.0})
    needed = float(str(error.value).split("at least ")[1].split(" mm")[0])
    assert GelPad(**{**DOME, "thickness_mm": needed + 1e-3})


def integrated_volume(pad: GelPad, cells: int = 1200) -> float:
    """Midpoint rule over a quarter of the bounding rectangle, all of which are alike [mm^3]."""
    share = (np.arange(cells // 2) + 0.5) / cells
    grid = np.meshgrid(share * pad.length_x_mm, share * pad.length_y_mm, indexing="ij")
    xy = np.stack(grid, axis=-1)
    inside = pad.inside_distance_mm(xy) > 0
    column = (pad.height_mm(xy) + pad.thickness_mm) * inside
    area = pad.length_x_mm * pad.length_y_mm
    # What the rule misses of the rounded corners is nearly a wall high.
    missed = (pad.outline.area_mm2 - inside.mean() * area) * pad.min_wall_mm()
    return float(column.mean() * area + missed)


def test_flat_pad_has_the_volume_and_areas_of_a_prism() -> None:
    part = labelled_solid(GelPad(thickness_mm=4))
    outline, window = 24 * 20 - (4 - np.pi) * 2**2, 18 * 14
    perimeter = 2 * (24 + 20) - 8 * 2 + 2 * np.pi * 2
    assert part.solid.volume == pytest.approx(4 * outline, rel=1e-9)
    wanted = {"CONTACT": outline, "WINDOW": window, "BOND": outline - window, "SIDE": 4 * perimeter}
    assert {r.name: part.area_mm2(r) for r in Region} == pytest.approx(wanted, rel=1e-9)


@pytest.mark.thorough(cases=("values0-1e-05", "values2-1e-05", "values3-3e-05", "values4-0.0002"))
@pytest.mark.parametrize(
    ("values", "tolerance"),
    [
        (DOME, 1e-5),
        ({"crown_radius_x_mm": 189.0, "crown_radius_y_mm": 114.0}, 1e-5),
        ({"rim": "chamfer", "rim_mm": 0.8}, 1e-5),
        # The midpoint rule is slow where the fillet meets the wall.
        ({"rim": "fillet", "rim_mm": 0.8}, 3e-5),
        # The kernel's rim rolls on the sphere, the formula on its tangent plane.
        ({"rim": "fillet", **DOME}, 2e-4),
    ],
)
def test_solid_and_formulas_agree(values: dict[str, Any], tolerance: float) -> None:
    pad = GelPad(**values)
    part = labelled_solid(pad)
    assert part.volume_mm3 == pytest.approx(integrated_volume(pad), rel=tolerance)
    surface = tessellate_solid(part)
    top = surface.vertices_mm[np.unique(surface.triangles[surface.regions == Region.CONTACT])]
    inside = pad.inside_distance_mm(top[:, :2]) > pad.rim_setback_mm() + 1e-3
    np.testing.assert_allclose(top[inside, 2], pad.height_mm(top[inside, :2]), atol=2e-4)


def test_a_rim_that_the_kernel_leaves_out_is_noticed() -> None:
    """3.6 % too much gel: the face's radius is 24 m, and the rim falls by 1.5 mm."""
    pad = GelPad(
        length_x_mm=30.788743284948644, length_y_mm=32.71764397122602, rim="arc",
        corner_radius_mm=4.260061474251234, thickness_mm=4.255022618916337,
        crown_radius_y_mm=24264.26335531647, crown_pillow=0.9636708728449709,
        rim_mm=0.9967319403898857, rim_radius_mm=50.29238926713631, wall_mm=2.781363584280929,
        window_x_mm=13.854934478226891, window_y_mm=14.722939787051708,
    )  # fmt: skip
    with pytest.raises(InputError, match=r"mm3 where the pad has 416\d.\d mm3; use a smaller"):
        labelled_solid(pad)


def test_step_triangles_and_dimensions_are_those_of_the_solid(tmp_path: Path) -> None:
    dome, path = labelled_solid(GelPad(**DOME)), tmp_path / "pad.step"
    write_step(dome, path)
    assert import_step(path).volume == pytest.approx(dome.solid.volume, rel=1e-9)
    names = re.findall(r"ADVANCED_FACE\('(\w*)'", path.read_text())
    assert names == [region.name.lower() for region in dome.regions]
    assert set(names) == {"contact", "bond", "window", "side"}

    surface = tessellate_solid(dome)
    assert surface.volume_mm3() == pytest.approx(dome.solid.volume, rel=5e-4)
    up, regions = surface.normals()[:, 2], surface.regions
    assert (up[regions == Region.CONTACT] > 0.9).all()
    np.testing.assert_allclose(up[np.isin(regions, [Region.BOND, Region.WINDOW])], -1)
    assert np.abs(up[regions == Region.SIDE]).max() < 1e-3

    found = dimensions(dome, GelPad(**DOME))
    np.testing.assert_allclose(found["bounding_box_min"], [-12, -10, -5], atol=1e-6)
    # The box of an analytic sphere face may be padded by the kernel's tolerance.
    np.testing.assert_allclose(found["bounding_box_max"], [12, 10, 0], atol=1e-5)
    drop = 50 - np.sqrt(50**2 - 9**2 - 7**2)
    assert found["crown_drop_at_window_corner"] == pytest.approx(drop)


@pytest.mark.thorough
def test_mini_lies_on_the_measured_gel() -> None:
    step = real_data("sensor_geometry/gelsight_mini/gelsight_mini_gel_feats.step")
    vertices, triangles = import_step(str(step)).solids()[0].tessellate(0.005, 0.05)
    # The file's y is up, from 19.25 mm under the flange.
    raw = np.array([tuple(v) for v in vertices])
    measured = raw[:, [0, 2, 1]] + [0.25, 0.5, -19.25 - 4.0]
    ours = tessellate_solid(labelled_solid(MINI), tolerance_mm=0.005, angle_rad=0.1)
    here = surface_samples(ours.vertices_mm, ours.triangles, 8000)
    away, _ = ClosestPoint(measured, np.array(triangles))(here)
    assert away.max() < 0.1
    assert np.sqrt((away**2).mean()) < 0.02


@given(st.floats(16, 200), st.floats(3.5, 6), st.floats(0.3, 1.2))
@settings(max_examples=20)
def test_digit_sections_have_the_wanted_sag(radius: float, thickness: float, roll: float) -> None:
    pad = DigitPad(mid_radius_mm=radius, thickness_mm=thickness + 2, roll_off=roll, rim_mm=0.0)
    ends = pad.height_mm(np.array([[0.0, 0.0], [9.2, 0.0]]))
    # The polynomial's section drops 2.0595 mm where an arc of 21.4 mm drops 2.0784 mm.
    sag = radius - np.sqrt(radius**2 - 9.2**2)
    assert ends[0] - ends[1] == pytest.approx(sag * 2.0595 / 2.0784, rel=1e-3)
    y = np.linspace(-12.5, 12.5, 400)
    line = pad.height_mm(np.stack([0 * y, y], axis=1))
    assert line.max() == pytest.approx(0, abs=1e-4)


@pytest.mark.thorough
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
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
    on_edge, normals = DIGIT.outline.at_mm(np.linspace(-0.5, 0.5, 101) + length)
    centers = on_edge - r * normals
    reach = r**2 - ((p - centers) ** 2).sum(axis=1)
    best = -np.inf
    for center, left in zip(centers[reach >= 0], reach[reach >= 0], strict=True):
        under = DIGIT.crown_mm(center + disc) - np.sqrt(r**2 - (disc**2).sum(axis=1))
        best = max(best, float(under.min() + np.sqrt(left)))
    found, crown = float(DIGIT.height_mm(p)), float(DIGIT.crown_mm(p))
    if found < crown:
        assert best == pytest.approx(found, abs=4e-3)
    else:
        # Beyond the fillet the crown itself is the top: a ball touching it there fits inside.
        assert found == crown and best < found + 1e-9
        g = DIGIT.crown_slope(p)
        assert DIGIT.inside_distance_mm(p + r * g / np.sqrt(1 + (g**2).sum())) >= r


def test_skin_and_core_have_the_volumes_of_their_prisms() -> None:
    solids, corners = layer_solids(SKINNED), 4 - np.pi
    core = (29.5 * 22.5 - corners * 1.0**2) * 2.5
    whole = (31.1 * 24.1 - corners * 1.8**2) * 2.8
    assert SKINNED.layer_names == ("gel", "skin") == tuple(solids)
    assert solids["gel"].volume == pytest.approx(core, rel=1e-9)
    assert solids["skin"].volume == pytest.approx(whole - core, rel=1e-9)
    assert MINI.layer_names == ("gel",) == tuple(layer_solids(MINI))


def test_glued_walls_are_bond() -> None:
    part, outline = labelled_solid(BEVELLED), BEVELLED.outline
    assert part.area_mm2(Region.SIDE) == 0
    back = outline.area_mm2 - BEVELLED.window_x_mm * BEVELLED.window_y_mm
    wanted = back + outline.perimeter_mm * 2.971
    assert part.area_mm2(Region.BOND) == pytest.approx(wanted, rel=1e-3)
    points = np.array([[19.9, 0, -3.5], [0, 0, -5.8], [10.0, 19.99, -5.0]])
    moved = BEVELLED.bond_projection_mm(points)
    np.testing.assert_allclose(moved, [[20, 0, -3.5], [0, 0, -5.925], [10, 20, -5.0]])


THIN, THICK = ({"thickness_mm": t, "crown_radius_x_mm": r} for t, r in ((2, 30.0), (40, 14.0)))


test_what_cannot_be_built_names_its_bound = refuses(
    lambda pad, values: replace(pad, **values),
    (GelPad(), {"thickness_mm": -1}, "thickness_mm = -1 .* 0.5 to 40 mm"),
    (GelPad(), {"corner_radius_mm": 11}, "corner_radius_mm = 11 .* up to 9.95 mm"),
    (GelPad(), {"rim": "fillet", "rim_mm": 1.9}, "rim_mm = 1.9 .* up to 1.8 mm"),
    (GelPad(), THIN, "of wall.* thickness_mm must be"),
    (GelPad(), THICK, "crown radii .* up to 0.8"),
    (GelPad(), {"window_x_mm": 23.9}, "window_x_mm .* at least 0.2 mm"),
    (GelPad(), {"rim": "bevel"}, "rim .* none, chamfer, fillet"),
    (GelPad(), {"length_x_mm": float("nan")}, "length_x_mm .* 4 to 100 mm"),
    (MINI, {"wall_mm": 3.9}, "wall_mm = 3.9 .* 0.3 to 3.6"),
    (MINI, {"rim_radius_mm": 3.2}, "rim_radius_mm = 3.2 .* at least 3.40935"),
    (MINI, {"rim_mm": 9}, "rim_mm = 9 .* up to 8.3"),
    (BEVELLED, {"crown_radius_x_mm": 200}, "wall_mm .*flat contact face"),
    (SKINNED, {"skin_top_mm": 0}, "skin_side_mm = 0.8 .*skin_top_mm"),
    (SKINNED, {"skin_top_mm": 2.7}, "skin_top_mm = 2.7 .* up to 2.5"),
    (SKINNED, {"skin_side_mm": 1.7}, "skin_side_mm = 1.7 .* up to 1.62"),
    (SKINNED, {"rim": "fillet"}, "rim none, chamfer or arc"),
    (SKINNED, {"window_x_mm": 29.4}, "window_x_mm .* at least 0.2 mm"),
    (DIGIT, {"rim_mm": 1.3}, "rim_mm = 1.3 .* up to 1.17"),
    (DIGIT, {"mid_radius_mm": 10}, "mid_radius_mm = 10 .* at least 11.96"),
    (DIGIT, {"length_mm": 11}, "length_mm = 11 .* at least 11.5"),
    (DIGIT, {"thickness_mm": 2.5}, "of wall.* thickness_mm must be at least"),
    (DIGIT, {"window_y_mm": 22}, "window_x_mm .* at least 0.2 mm"),
    (DIGIT, {"roll_off": 3}, "roll_off = 3 .* 0 to 2"),
)
