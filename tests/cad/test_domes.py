# SPDX-License-Identifier: Apache-2.0
"""Domes: dimensions of real sensors, closed forms, solids, and their structured meshes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.dome_mesh import graded_shares
from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh, gel_mesh
from taccel_lab.cad.mesh.grid import grid_of, plan_triangles
from taccel_lab.cad.mesh.quality import PRESS_GATE, MeshQuality, measure_quality, require_quality
from taccel_lab.cad.mesh.surface import check_closed
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.dome_pad import DomePad, ShellDomePad, SolidDomePad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.geometry import Region
from tests.cad import pads
from tests.support.sensor_refusals import refuses
from tests.support.variants import variants


def test_digit_360_as_measured() -> None:
    """On the part: 10534.8 mm3, cone from 4.927 to 4.879 mm, torus 4.629 / 0.25 mm."""
    figures = pads.DIGIT_360.figures()
    assert figures["total_height"] == pytest.approx(26.0)
    assert figures["base_diameter"] == pytest.approx(25.0)
    assert labelled_solid(pads.DIGIT_360).volume_mm3 == pytest.approx(10534.8, rel=1e-4)
    wall, fillet, _ = pads.DIGIT_360.meridian.of(Region.WINDOW)
    assert wall.point(np.ones(()))[0] == pytest.approx(4.879, abs=5e-4)
    assert fillet.point(np.array([0.0, 1.0]))[1, 1] == pytest.approx(-26 + 1.55)
    assert pads.DIGIT_360.thickness_mm == pytest.approx(26 - figures["pocket_depth_at_axis"])
    np.testing.assert_allclose(pads.GEL_TIP.bounds_mm(), [[-11.5, -11.5, -21.5], [11.5, 11.5, 0]])


@given(pads.domes())
@settings(max_examples=60)
def test_the_meridian_is_a_closed_chain_from_axis_to_axis(pad: DomePad) -> None:
    assert pad.meridian.gap_mm() < 1e-9
    pieces = pad.meridian.pieces
    np.testing.assert_allclose(pieces[0].point(np.zeros(())), [0, 0], atol=1e-12)
    end = pieces[-1].point(np.ones(()))
    np.testing.assert_allclose(end, [0, -pad.thickness_mm], atol=1e-9)
    low, high = pad.bounds_mm()
    points = np.concatenate([piece.point(np.linspace(0, 1, 50)) for piece in pieces])
    assert points[:, 1].min() >= low[2] - 1e-9 and (points.max(axis=0) <= high[1:] + 1e-9).all()
    assert min(pad.meridian.area_mm2(r) for r in Region if r is not Region.SIDE) > 0


@given(pads.domes(), st.floats(0, 0.99), st.floats(-np.pi, np.pi), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_surfaces_are_those_of_formulas(pad: DomePad, share: float, turn: float, seed: int) -> None:
    way = pad.cap_radius_mm * np.array([np.cos(turn), np.sin(turn)])
    xy = share * way
    point = np.append(xy, pad.top_mm(xy))
    assert pad.contact_error_mm(point[None])[0] < 1e-9
    normal = (point + [0, 0, pad.dome_radius_mm]) / pad.dome_radius_mm
    np.testing.assert_allclose(pad.top_normal(xy), normal, atol=1e-9)
    assert np.isnan(pad.top_mm(1.01 * way)) and np.isnan(pad.top_normal(1.01 * way)).all()
    # The projection lands on glued pieces, and stays there.
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
        pads.DIGIT_360,
        pads.R_TAC,
        pads.GEL_TIP,
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
    agree = pad.region_of(surface.vertices_mm[surface.triangles].mean(axis=1)) == surface.regions
    assert (surface.areas_mm2() * agree).sum() > 0.99 * surface.areas_mm2().sum()


def check_even(pad: DomePad, edge_mm: float, window_slack: float) -> MeshQuality:
    """Contact nodes lie on the cap, faces in their regions; the window has its area."""
    mesh = gel_mesh(pad, edge_mm)
    pads.check_sound(mesh, pad)
    contact = mesh.nodes_m[mesh.region_nodes(Region.CONTACT)] * 1e3
    assert contact[:, 2].min() > -pad.dome_radius_mm * (1 - np.cos(pad.cap_angle)) - 1e-9
    centers = mesh.nodes_m[mesh.faces].mean(axis=1) * 1e3
    # Chords lie a little off the surfaces, so that faces at borders may go either way.
    assert (pad.region_of(centers) == mesh.face_regions).mean() > 0.9
    quality = measure_quality(mesh, pad, cad_volume_mm3=pad.meridian.volume_mm3())
    window = pad.meridian.area_mm2(Region.WINDOW)
    assert quality.region_areas_mm2["window"] == pytest.approx(window, rel=window_slack)
    return quality


@pytest.mark.thorough
@given(pads.shell_domes(), st.floats(0.8, 1.5))
@settings(max_examples=5)
def test_even_shells_are_sound(pad: ShellDomePad, edge_mm: float) -> None:
    quality = check_even(pad, min(edge_mm, pad.dome_radius_mm / 8), 0.05)
    assert quality.min_dihedral_deg >= 10
    assert quality.volume_error_percent is not None and -1.5 < quality.volume_error_percent < 0


@pytest.mark.thorough
@given(pads.solid_domes())
@settings(max_examples=4)
def test_even_solids_are_sound(pad: SolidDomePad) -> None:
    quality = check_even(pad, pad.dome_radius_mm / 9, 0.03)
    assert quality.min_dihedral_deg >= 9
    assert quality.volume_error_percent is not None and abs(quality.volume_error_percent) < 0.7


@pytest.mark.parametrize(
    ("pad", "changes"),
    [
        (pads.R_TAC, {"thickness_mm": 1.8, "opening_deg": 89.0}),
        (pads.GEL_TIP, {"skirt_mm": 10.3, "thickness_mm": 2.2, "dome_radius_mm": 11.6}),
        (pads.DIGIT_360, {"wall_height_mm": 13.7, "pocket_depth_mm": 1.7, "dome_radius_mm": 12.6}),
    ],
)
def test_a_sweep_keeps_the_connectivity(pad: DomePad, changes: dict[str, float]) -> None:
    first, second = (gel_mesh(p, 1.6) for p in (pad, replace(pad, **changes)))
    pads.check_same(first, second)
    assert np.abs(first.nodes_m - second.nodes_m).max() > 1e-5


@pytest.mark.thorough
@pytest.mark.parametrize("pad", variants([pads.R_TAC], [pads.DIGIT_360, pads.R_TAC, pads.GEL_TIP]))
def test_focused_meshes_share_connectivity_and_are_fine_at_the_contact(pad: DomePad) -> None:
    reference = None
    for share, turn in ((0.0, 0.0), (0.5, 1.0), (0.8, -2.5)):
        x, y = (share * pad.cap_radius_mm * np.array([np.cos(turn), np.sin(turn)])).tolist()
        mesh = focused_gel_mesh(pad, FocusOptions((x, y), radius_mm=3.8, size_mm=0.2))
        pads.check_sound(mesh, pad)
        quality = measure_quality(mesh, pad, cad_volume_mm3=pad.meridian.volume_mm3())
        require_quality(mesh, quality, PRESS_GATE)
        reference = reference or mesh
        pads.check_same(mesh, reference)
        lengths, away = pads.contact_edges(mesh, (x, y, float(pad.top_mm(np.array([x, y])))))
        assert np.quantile(lengths[away < 3], 0.25) == pytest.approx(0.2, rel=0.3)
        assert lengths[away < 3].max() < 3.2 * 0.2
        assert np.median(lengths[away > 10]) > 5 * 0.2


def test_the_fine_plan_holds_four_triangles_for_each_coarse_one() -> None:
    grid = grid_of(6, 4, 4, halved_layers=2)
    coarse, fine = 4 * 4 + 12 * 2, 7 * 7 + 24 * 4
    assert np.bincount(grid.level).tolist() == [*3 * [coarse], *2 * [fine]]
    # Every triangle between two tets is seen from both sides: no gap between coarse and fine.
    check_closed(grid.faces, "boundary")
    # Squares inside squares, so that middles of coarse edges lie on them.
    theta = -0.75 * np.pi + 2 * np.pi * np.arange(24) / 24
    around = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    around /= np.abs(around).max(axis=1, keepdims=True)
    t = np.linspace(-1, 1, 7)
    core = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    plan = np.concatenate([core, *((1.5 + 0.5 * ring) * around for ring in range(4))])
    points = np.column_stack([plan[grid.plan], grid.level])[grid.tets]
    volumes = np.linalg.det(points[:, 1:] - points[:, :1]) / 6
    assert volumes.min() > 0
    # A square of side 6, 4 high; nodes by angle miss the middles of its sides a little.
    assert volumes.sum() == pytest.approx(36 * 4, rel=0.02)
    top = (grid.level[grid.faces] == 4).all(axis=1).sum()
    assert top == 4 * len(plan_triangles(3, 2))


@given(st.floats(0.05, 3), st.floats(1, 30), st.integers(1, 20))
def test_graded_layers_fill_their_column(size: float, length: float, layers: int) -> None:
    shares = graded_shares(np.array([size]), np.array([length]), layers)[:, 0]
    heights = np.diff(shares)
    assert shares[0] == 0 and shares[-1] == 1 and (heights > 0).all()
    assert (np.diff(heights) <= 1e-9).all()
    if layers > 5 and size < length / (3 * layers):
        assert heights[-1] * length == pytest.approx(size, rel=0.5)


DEEP = {"pocket_depth_mm": 24.5, "pocket_taper_deg": 0, "pocket_radius_mm": 3}
WIDE = {"pocket_depth_mm": 22, "pocket_radius_mm": 10, "pocket_dome_radius_mm": 200}
AROUND = {"at_mm": (0, 0), "radius_mm": 2.0, "size_mm": 0.25, "rings": 24}


def build(made: Any, values: dict[str, Any]) -> None:
    if isinstance(made, type):
        made(**values)
    elif "edge_mm" in values:
        gel_mesh(made, **values)
    else:
        focused_gel_mesh(made, FocusOptions(**{**AROUND, **values}))


test_what_cannot_be_built_or_meshed_is_refused = refuses(
    build,
    (SolidDomePad, {"dome_radius_mm": 2}, "dome_radius_mm = 2 is below"),
    (SolidDomePad, {"bonded_wall_mm": 13.4}, "bonded_wall_mm = 13.4 leaves less"),
    (SolidDomePad, {"pocket_radius_mm": 12}, "too narrow a base"),
    (SolidDomePad, {"pocket_dome_radius_mm": 4}, "no room for its wall"),
    (SolidDomePad, {"pocket_edge_radius_mm": 3}, "no room for its wall"),
    (SolidDomePad, DEEP, "leaves .* of gel under the apex"),
    (SolidDomePad, WIDE, "comes within .* of the contact face"),
    (ShellDomePad, {"thickness_mm": 14}, "leaves a core"),
    (ShellDomePad, {"opening_deg": 60, "skirt_mm": 3}, "needs a hemisphere"),
    (ShellDomePad, {"opening_deg": 60, "window_deg": 70}, "does not fit a cap"),
    (ShellDomePad, {"rim": "free"}, "nothing but the window is glued"),
    (ShellDomePad, {"rim": "loose"}, "one of bonded, free"),
    (pads.R_TAC, {"at_mm": (14.93, 0)}, "allowed: up to 14.925"),
    (pads.R_TAC, {"at_mm": (20, 0)}, "from the axis"),
    (pads.R_TAC, {"at_mm": (float("nan"), 0)}, "pair of numbers"),
    (pads.R_TAC, {"core": 7}, "core = 7 is odd"),
    (pads.R_TAC, {"rings": 23}, "rings = 27 is odd"),
    (pads.R_TAC, {"rings": 400}, "rings = 400"),
    (pads.DIGIT_360, {"layers": 0}, "layers = 0"),
    (pads.DIGIT_360, {"size_mm": 9}, "size_mm"),
    (pads.DIGIT_360, {"radius_mm": 99}, "radius_mm"),
    (pads.R_TAC, {"edge_mm": 0.1}, "edge_mm"),
    (pads.R_TAC, {"edge_mm": 99.0}, "edge_mm"),
    (pads.R_TAC, {"edge_mm": float("nan")}, "edge_mm"),
)
