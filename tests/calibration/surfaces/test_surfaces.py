# SPDX-License-Identifier: Apache-2.0
"""Surfaces of presses: closed forms, and read off those of a few others."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.surfaces import PressSurface, analytic_surface
from taccel_lab.calibration.surfaces.shared_law import SPANNING, SharedLaw, spanning_presses
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normals import normals_from_height

GRID = PixelGrid(200, 160, 0.05, 0.05)
CIRCLE = ContactCircle(100.0, 80.0, 20.0)


def test_in_contact_it_is_the_sphere_and_beyond_the_skirt_flat() -> None:
    surface = analytic_surface(CIRCLE, GRID, 2.0, decay_mm=1e-4)
    x = np.arange(200) - 100.0
    inside = np.abs(x) < 19
    expected = 2.0 - np.sqrt(4.0 - (0.05 * x[inside]) ** 2)
    height = surface.height_m[80] * 1e3
    assert height[inside] - height[100] == pytest.approx(expected, abs=1e-4)
    assert np.all(surface.height_m[80, 121:] == pytest.approx(0.0, abs=1e-9))
    assert surface.depth_mm == pytest.approx(2.0 - math.sqrt(3.0), abs=1e-3)
    assert surface.normals[80, 110] == pytest.approx([-0.25, 0.0, math.sqrt(1 - 0.0625)], abs=1e-3)


@pytest.mark.parametrize("decay_mm", [math.inf, 1.0])
def test_normals_belong_to_the_heights(decay_mm: float) -> None:
    surface = analytic_surface(CIRCLE, GRID, 2.0, decay_mm=decay_mm)
    numeric = normals_from_height(surface.height_m, GRID)
    ring = np.abs(CIRCLE.distance_px(GRID) - 20) > 2  # the slope has a kink at the rim
    assert np.abs(numeric - surface.normals)[ring].max() < 5e-3


def test_skirt_follows_johnson() -> None:
    surface = analytic_surface(CIRCLE, GRID, 2.0)
    r = 0.05 * np.arange(22, 90)
    rim = 1.0
    johnson = (2 * rim**2 - r**2) * np.arcsin(rim / r) + rim * np.sqrt(r**2 - rim**2)
    height = surface.height_m[80, 122:190] * 1e3
    slope = (1.0 / math.sqrt(3.0)) / (math.pi * rim)
    assert np.diff(height) == pytest.approx(-slope * np.diff(johnson), rel=0.01)


def test_refuses_a_rim_beyond_the_ball() -> None:
    with pytest.raises(InputError, match="not below the ball's radius"):
        analytic_surface(ContactCircle(100.0, 80.0, 41.0), GRID, 2.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"height_m": np.zeros((3, 3))}, "rest_height_m has shape"),
        ({"contact_radius_px": math.nan}, "contact_radius_px"),
        ({"rest_height_m": np.full((160, 200), np.nan)}, "rest_height_m holds NaN"),
    ],
)
def test_surface_checks_itself(change: dict[str, object], message: str) -> None:
    surface: PressSurface = analytic_surface(CIRCLE, GRID, 2.0)
    with pytest.raises(InputError, match=message):
        dataclasses.replace(surface, **change)  # type: ignore[arg-type]


LAW_GRID = PixelGrid(160, 120, 0.08, 0.08)
BALL_MM = 2.0
RADII = (12.0, 19.0, 14.5, 16.0, 20.0, 13.0, 17.5, 15.0, 18.0, 12.5)
CIRCLES = [
    ContactCircle(50.0 + 31 * (i % 3), 48.0 + 23 * (i % 2), radius)
    for i, radius in enumerate(RADII)
]


def press(circle: ContactCircle, ball_mm: float = BALL_MM) -> PressSurface:
    return analytic_surface(circle, LAW_GRID, ball_mm, decay_mm=1.0)


def crowned(surface: PressSurface, circle: ContactCircle) -> PressSurface:
    """The dent in a gel that is bowed at rest: its lean is gone under the ball, and comes back
    beside it."""
    x = (np.arange(LAW_GRID.width_px)[None, :] - 80.0) * LAW_GRID.mm_per_px_x
    y = (np.arange(LAW_GRID.height_px)[:, None] - 60.0) * LAW_GRID.mm_per_px_y
    rest = np.stack(np.broadcast_arrays(-0.012 * x, -0.012 * y), axis=-1)
    under = -0.012 * np.array(
        [(circle.u_px - 80.0) * LAW_GRID.mm_per_px_x, (circle.v_px - 60.0) * LAW_GRID.mm_per_px_y]
    )
    away = circle.distance_px(LAW_GRID) / circle.radius_px
    gone = np.clip(2.0 - away, 0.0, 1.0)[..., None] * under
    slope = -surface.normals[..., :2] / surface.normals[..., 2:] + rest - gone
    return replace(surface, normals=normals_of(slope), rest_normals=normals_of(rest))


def normals_of(slope: np.ndarray) -> np.ndarray:
    normals = np.concatenate([-slope, np.ones((*slope.shape[:2], 1))], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def angle_deg(a: PressSurface, b: PressSurface) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((a.normals * b.normals).sum(axis=-1), -1, 1)))


@cache
def law(bowed: bool) -> tuple[SharedLaw, list[int]]:
    chosen = spanning_presses(CIRCLES)
    surfaces = [press(CIRCLES[i]) for i in chosen]
    if bowed:
        surfaces = [crowned(s, CIRCLES[i]) for s, i in zip(surfaces, chosen, strict=True)]
    return SharedLaw.of(surfaces, [CIRCLES[i] for i in chosen], LAW_GRID), chosen


@pytest.mark.parametrize("bowed", [False, True])
def test_other_presses_come_out_as_if_simulated(bowed: bool) -> None:
    found, chosen = law(bowed)
    assert found.holds
    for i, circle in enumerate(CIRCLES):
        if i in chosen:
            continue
        wanted = crowned(press(circle), circle) if bowed else press(circle)
        surface = found.surface(circle, circle.radius_px)
        off = angle_deg(surface, wanted)
        near = circle.distance_px(LAW_GRID) <= 2.5 * circle.radius_px
        assert off[near].mean() < 0.35 and off[~near].mean() < 0.25
        sunk = surface.displacement_mm() - wanted.displacement_mm()
        assert np.abs(sunk[near]).mean() < 0.02 * surface.depth_mm or bowed
        assert surface.contact_radius_px == circle.radius_px
        assert surface.depth_mm == pytest.approx(press(circle).depth_mm, rel=0.05)
        assert surface.provider.startswith(f"between {SPANNING} presses")


def test_a_lean_that_the_ball_takes_away_is_learned() -> None:
    """Without it the gel under the ball would lean as it does at rest: up to 1.7 degrees here."""
    found, chosen = law(True)
    without = replace(found, lean=np.zeros_like(found.lean))
    circle = CIRCLES[next(i for i in range(len(CIRCLES)) if i not in chosen)]
    wanted = crowned(press(circle), circle)
    disc = circle.distance_px(LAW_GRID) <= 0.9 * circle.radius_px
    with_lean, plain = (
        angle_deg(one.surface(circle, circle.radius_px), wanted)[disc].mean()
        for one in (found, without)
    )
    assert with_lean < 0.5 * plain


def test_presses_that_one_law_does_not_explain_are_seen() -> None:
    chosen = [CIRCLES[i] for i in spanning_presses(CIRCLES)]
    balls = (2.0, 2.9, 2.0, 2.6, 2.0, 3.2)
    surfaces = [press(c, ball) for c, ball in zip(chosen, balls, strict=True)]
    assert not SharedLaw.of(surfaces, chosen, LAW_GRID).holds


@settings(max_examples=30)
@given(
    st.lists(
        st.tuples(st.floats(20, 140), st.floats(20, 100), st.floats(8, 25)),
        min_size=1,
        max_size=30,
        unique=True,
    )
)
def test_spanning_presses_hold_the_extremes(values: list[tuple[float, float, float]]) -> None:
    circles = [ContactCircle(*value) for value in values]
    chosen = spanning_presses(circles)
    assert chosen == sorted(set(chosen)) and len(chosen) == min(SPANNING, len(circles))
    radii = [c.radius_px for c in circles]
    taken = [radii[i] for i in chosen]
    assert min(taken) == min(radii) and (max(taken) == max(radii) or len(chosen) == 1)
