# SPDX-License-Identifier: Apache-2.0
"""Curves that parts and meshes are drawn along: meridians, outlines, and their maps to the disc."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.conformal import disc_map
from taccel_lab.cad.mesh.outline_nodes import MAX_SAGITTA_MM, needed_cells, outline_nodes
from taccel_lab.cad.parts.meridian import Arc, Line, Meridian, Piece, closest_on_pieces
from taccel_lab.cad.parts.pad_outline import PadOutline, d_shape, rounded_rectangle
from taccel_lab.geometry import Region

S = Region.SIDE


def test_cone_cylinder_disc_and_torus() -> None:
    cone = Line((3.0, 0.0), (1.0, 4.0), S)
    assert cone.area_mm2() == pytest.approx(np.pi * (3 + 1) * np.hypot(2, 4))
    assert cone.volume_mm3() == pytest.approx(np.pi * 4 / 3 * (9 + 3 + 1))
    assert Line((2.0, 1.0), (2.0, -4.0), S).area_mm2() == pytest.approx(2 * np.pi * 2 * 5)
    assert Line((0.0, 7.0), (2.0, 7.0), S).area_mm2() == pytest.approx(np.pi * 4)
    assert Line((0.0, 7.0), (2.0, 7.0), S).volume_mm3() == 0
    ring = Meridian((Arc((5.0, 0.0), 1.0, 0.0, 2 * np.pi, S),))
    assert ring.area_mm2(S) == pytest.approx(4 * np.pi**2 * 5)
    assert ring.volume_mm3() == pytest.approx(2 * np.pi**2 * 5)


@given(st.floats(0.5, 20), st.floats(0.1, 3.1))
def test_spherical_caps(radius: float, angle: float) -> None:
    cap = Arc((0.0, -radius), radius, 0.0, angle, S)
    height = radius * (1 - np.cos(angle))
    assert cap.length_mm == pytest.approx(radius * angle)
    assert cap.area_mm2() == pytest.approx(2 * np.pi * radius * height, rel=1e-9)
    # A curve that goes down counts negative.
    wanted = -np.pi * height**2 * (3 * radius - height) / 3
    assert cap.volume_mm3() == pytest.approx(wanted, rel=1e-9)


@example([5e-324, 5e-324, 0.0], (Line((1.0, 0.0), (3.0, 2.0), S),))
@given(
    st.lists(st.floats(-8, 8), min_size=3, max_size=3),
    st.sampled_from([
        (Line((1.0, 0.0), (3.0, 2.0), S),),
        (Arc((0.0, -4.0), 4.0, 0.0, 1.3, S), Line((3.85, -2.93), (3.85, -6.0), Region.BOND)),
        (Arc((3.0, 0.0), 0.5, 1.4, 0.3, S),),
        (Arc((2.0, 0.0), 1.0, -2.0, 2.6, S),),
    ]),
)  # fmt: skip
def test_closest_points_are_closest(point: list[float], pieces: tuple[Piece, ...]) -> None:
    at = np.array([point])
    found, piece = closest_on_pieces(pieces, at)
    distance = float(np.linalg.norm(found - at))
    t = np.linspace(0, 1, 4001)
    rz = np.array([np.hypot(at[0, 0], at[0, 1]), at[0, 2]])
    sampled = [float(np.linalg.norm(p.point(t) - rz, axis=1).min()) for p in pieces]
    assert distance == pytest.approx(min(sampled), abs=3e-3)
    assert sampled[int(piece[0])] == pytest.approx(min(sampled), abs=3e-3)
    again, _ = closest_on_pieces(pieces, found)
    np.testing.assert_allclose(again, found, atol=1e-9)


ANY_OUTLINE = st.one_of(
    st.builds(rounded_rectangle, st.floats(14, 40), st.floats(14, 40), st.floats(0.3, 6)),
    st.builds(d_shape, st.floats(12, 26), st.floats(22, 40), st.floats(0.5, 4)),
)


def dense(outline: PadOutline, count: int = 6000) -> np.ndarray:
    return outline.at_mm(np.linspace(0, outline.perimeter_mm, count, endpoint=False))[0]


def test_digit_has_the_measured_outline() -> None:
    outline = d_shape(18.4, 25.0, 1.3)
    np.testing.assert_allclose(outline.bounds_mm(), [[-9.2, -12.5], [9.2, 12.5]], atol=1e-12)
    # Half circle, rectangle below it, less two corners.
    area = np.pi * 9.2**2 / 2 + 18.4 * 15.8 - (2 - np.pi / 2) * 1.3**2
    assert outline.area_mm2 == pytest.approx(area, rel=1e-12)
    perimeter = np.pi * 9.2 + 2 * 14.5 + 15.8 + np.pi * 1.3
    assert outline.perimeter_mm == pytest.approx(perimeter, rel=1e-12)
    points = np.array([[0.0, 3.3], [0, 12], [8, 0], [0, -12], [-9.5, -5]])
    np.testing.assert_allclose(outline.inside_distance_mm(points), [9.2, 0.5, 1.2, 0.5, -0.3])


@pytest.mark.thorough
@given(ANY_OUTLINE, st.integers(0, 2**32 - 1))
def test_distance_is_that_of_the_nearest_outline_point(outline: PadOutline, seed: int) -> None:
    low, high = outline.bounds_mm()
    points = np.random.default_rng(seed).uniform(low - 3, high + 3, (60, 2))
    loop = dense(outline)
    # To the chords, not to their ends: near the outline the ends are half a step too far.
    along = np.roll(loop, -1, axis=0) - loop
    share = ((points[:, None] - loop) * along).sum(axis=-1) / (along**2).sum(axis=-1)
    foot = loop + np.clip(share, 0, 1)[..., None] * along
    nearest = np.linalg.norm(points[:, None] - foot, axis=-1).min(axis=1)
    distance = outline.inside_distance_mm(points)
    np.testing.assert_allclose(np.abs(distance), nearest, atol=2e-3)
    edge = points + distance[:, None] * outline.outward_normal(points)
    np.testing.assert_allclose(outline.inside_distance_mm(edge), 0, atol=1e-9)


@given(ANY_OUTLINE)
def test_lengths_areas_and_normals_are_those_of_the_loop(outline: PadOutline) -> None:
    loop = dense(outline)
    following = np.roll(loop, -1, axis=0)
    steps = following - loop
    assert outline.perimeter_mm == pytest.approx(np.linalg.norm(steps, axis=1).sum(), rel=1e-4)
    cross = loop[:, 0] * following[:, 1] - loop[:, 1] * following[:, 0]
    assert outline.area_mm2 == pytest.approx(cross.sum() / 2, rel=1e-5)
    _, normals = outline.at_mm(np.linspace(0, outline.perimeter_mm, 6000, endpoint=False))
    across = (steps * normals).sum(axis=1) / np.linalg.norm(steps, axis=1)
    assert np.abs(across).max() < 0.05


@pytest.mark.thorough
@given(ANY_OUTLINE, st.floats(0.5, 2))
@settings(max_examples=15)
def test_nodes_keep_the_sagitta(outline: PadOutline, edge_mm: float) -> None:
    needed = needed_cells(outline, edge_mm)
    cells = 2 * int(np.ceil(needed.max() / 2))
    nodes, _ = outline_nodes(outline, cells)
    assert nodes.shape == (4 * cells, 2)
    np.testing.assert_allclose(outline.inside_distance_mm(nodes), 0, atol=1e-9)
    t = np.linspace(0, 1, 9)[:, None, None]
    chords = (1 - t) * nodes + t * np.roll(nodes, -1, axis=0)
    assert outline.inside_distance_mm(chords).max() < 1.1 * MAX_SAGITTA_MM
    along = np.roll(nodes, -1, axis=0) - nodes
    assert (nodes[:, 0] * along[:, 1] - nodes[:, 1] * along[:, 0] > 0).all()


@pytest.mark.parametrize(
    "outline",
    [
        rounded_rectangle(24, 20, 2),
        rounded_rectangle(20, 25, 1.5),
        rounded_rectangle(16, 16, 4),
        d_shape(18.4, 25, 1.3),
        d_shape(18.4, 25, 1.3).inset(0.9),
    ],
)
def test_outline_maps_to_the_circle_and_back(outline: PadOutline) -> None:
    chart = disc_map(outline)
    np.testing.assert_allclose(np.abs(chart.disc_from_plan(chart.outline_mm)), 1, atol=2e-4)
    for factor in (0.2, 0.5, 0.8):
        z = factor * chart.outline_mm
        np.testing.assert_allclose(chart.plan_from_disc(chart.disc_from_plan(z)), z, atol=2e-3)
