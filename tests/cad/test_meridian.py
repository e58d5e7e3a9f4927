# SPDX-License-Identifier: Apache-2.0
"""Bodies of revolution against closed forms and dense samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from taccel_lab.cad.parts.meridian import Arc, Line, Meridian, Piece, closest_on_pieces
from taccel_lab.geometry import Region

S = Region.SIDE


def test_cone_cylinder_and_disc() -> None:
    cone = Line((3.0, 0.0), (1.0, 4.0), S)
    assert cone.area_mm2() == pytest.approx(np.pi * (3 + 1) * np.hypot(2, 4))
    assert cone.volume_mm3() == pytest.approx(np.pi * 4 / 3 * (9 + 3 + 1))
    assert Line((2.0, 1.0), (2.0, -4.0), S).area_mm2() == pytest.approx(2 * np.pi * 2 * 5)
    assert Line((0.0, 7.0), (2.0, 7.0), S).area_mm2() == pytest.approx(np.pi * 4)
    assert Line((0.0, 7.0), (2.0, 7.0), S).volume_mm3() == 0


@given(st.floats(0.5, 20), st.floats(0.1, 3.1))
def test_spherical_caps(radius: float, angle: float) -> None:
    cap = Arc((0.0, -radius), radius, 0.0, angle, S)
    height = radius * (1 - np.cos(angle))
    assert cap.length_mm == pytest.approx(radius * angle)
    assert cap.area_mm2() == pytest.approx(2 * np.pi * radius * height, rel=1e-9)
    # A curve that goes down counts negative.
    wanted = -np.pi * height**2 * (3 * radius - height) / 3
    assert cap.volume_mm3() == pytest.approx(wanted, rel=1e-9)


def test_torus() -> None:
    ring = Meridian((Arc((5.0, 0.0), 1.0, 0.0, 2 * np.pi, S),))
    assert ring.area_mm2(S) == pytest.approx(4 * np.pi**2 * 5)
    assert ring.volume_mm3() == pytest.approx(2 * np.pi**2 * 5)


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


def test_points_on_the_axis_have_a_closest_point() -> None:
    found, _ = closest_on_pieces((Line((2.0, 1.0), (2.0, -1.0), S),), np.zeros((1, 3)))
    np.testing.assert_allclose(found, [[2, 0, 0]])
