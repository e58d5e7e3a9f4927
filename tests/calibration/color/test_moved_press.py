# SPDX-License-Identifier: Apache-2.0
"""Surfaces between simulated presses: other radii, other places, a leaning gel."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.surfaces import PressSurface, analytic_surface
from taccel_lab.calibration.surfaces.moved_press import MovedPress, moved_surfaces
from taccel_lab.calibration.surfaces.radial import MARGIN, RadialSurfaces
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

GRID = PixelGrid(160, 120, 0.08, 0.08)
BALL_MM = 2.0
CIRCLES = [
    ContactCircle(45.0 + 7 * i, 50.0 + 3 * (i % 4), radius)
    for i, radius in enumerate((12.0, 13.5, 15.0, 16.0, 17.5, 18.5, 20.0, 21.0))
]


def press(circle: ContactCircle) -> PressSurface:
    return analytic_surface(circle, GRID, BALL_MM, decay_mm=1.0)


def leaning(surface: PressSurface) -> PressSurface:
    """The same dent in a gel that leans at rest."""
    slope = np.array([0.08, -0.05])
    v, u = np.mgrid[: GRID.height_px, : GRID.width_px]
    plane = (slope[0] * u * GRID.mm_per_px_x + slope[1] * v * GRID.mm_per_px_y) * 1e-3

    def lean(normals: np.ndarray) -> np.ndarray:
        tilted = np.concatenate(
            [normals[..., :2] / normals[..., 2:] - slope, np.ones((*normals.shape[:2], 1))], axis=-1
        )
        return tilted / np.linalg.norm(tilted, axis=-1, keepdims=True)

    return replace(
        surface,
        height_m=surface.height_m + plane,
        rest_height_m=surface.rest_height_m + plane,
        normals=lean(surface.normals),
        rest_normals=lean(np.asarray(surface.rest_normals)),
    )


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=-1), -1, 1)))


@cache
def simulated(lean: bool) -> tuple[list[PressSurface], RadialSurfaces]:
    surfaces = [press(circle) for circle in CIRCLES]
    if lean:
        surfaces = [leaning(surface) for surface in surfaces]
    return surfaces, RadialSurfaces.of(surfaces, CIRCLES, GRID)


@settings(max_examples=12)
@given(
    du=st.floats(-3, 3),
    dv=st.floats(-3, 3),
    grown=st.floats(0.92, 1.08),
    which=st.integers(1, 5),
    lean=st.booleans(),
)
def test_a_moved_press_is_the_press_that_was_asked_for(
    du: float, dv: float, grown: float, which: int, lean: bool
) -> None:
    surfaces, library = simulated(lean)
    make = leaning if lean else (lambda surface: surface)
    start = CIRCLES[which]
    wanted = ContactCircle(start.u_px + du, start.v_px + dv, start.radius_px * grown)
    truth = make(press(wanted))
    near = np.flatnonzero(wanted.distance_px(GRID) < 2.0 * wanted.radius_px)
    normals, sunk = MovedPress.of(surfaces[which], start, library).at(wanted, near)
    apart = angle_deg(normals, truth.normals.reshape(-1, 3)[near])
    still = angle_deg(
        surfaces[which].normals.reshape(-1, 3)[near], truth.normals.reshape(-1, 3)[near]
    )
    assert apart.mean() < 0.6
    assert apart.mean() < 0.02 + still.mean()
    assert np.abs(sunk - truth.displacement_mm().reshape(-1)[near]).mean() < 0.012


def test_unmoved_presses_stay_as_they_are() -> None:
    surfaces, library = simulated(False)
    for before, after in zip(
        surfaces, moved_surfaces(surfaces, CIRCLES, CIRCLES, library), strict=True
    ):
        assert angle_deg(before.normals, after.normals).max() < 1e-5
        assert after.height_m == pytest.approx(before.height_m, abs=1e-12)
        assert np.array_equal(before.rest_normals, after.rest_normals)


def test_force_and_residual_of_another_press_are_not_kept() -> None:
    surfaces, library = simulated(False)
    stated = [
        replace(surface, force_n=1.5, residual_n=1e-5, depth_mm=0.3 + 0.1 * i)
        for i, surface in enumerate(surfaces)
    ]
    wanted = replace(CIRCLES[2], u_px=CIRCLES[2].u_px + 1.5, radius_px=CIRCLES[2].radius_px * 1.05)
    (moved,) = moved_surfaces([stated[2]], [CIRCLES[2]], [wanted], library)
    assert np.isnan(moved.force_n) and np.isnan(moved.residual_n)
    truth, before = press(wanted), surfaces[2]
    deeper = before.displacement_mm().min() - truth.displacement_mm().min()
    assert deeper > 0.01
    assert moved.depth_mm - stated[2].depth_mm == pytest.approx(deeper, rel=0.15)
    assert moved.provider != stated[2].provider
    (still,) = moved_surfaces([stated[2]], [CIRCLES[2]], [CIRCLES[2]], library)
    assert still.force_n == 1.5 and still.depth_mm == stated[2].depth_mm


def test_radii_stay_near_those_simulated() -> None:
    _, library = simulated(False)
    assert library.radius_range_px == pytest.approx((12.0 * (1 - MARGIN), 21.0 * (1 + MARGIN)))
    distance = np.linspace(0, 5, 50)
    for outside, limit in ((3.0, 12.0 * (1 - MARGIN)), (60.0, 21.0 * (1 + MARGIN))):
        for a, b in zip(
            library.profiles_at(outside, distance), library.profiles_at(limit, distance),
            strict=True,
        ):  # fmt: skip
            assert np.array_equal(a, b)


def test_no_surfaces_are_refused() -> None:
    with pytest.raises(InputError, match="at least one surface"):
        RadialSurfaces.of([], [], GRID)
