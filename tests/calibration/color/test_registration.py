# SPDX-License-Identifier: Apache-2.0
"""Circles read again with the colours, and the surfaces between simulated presses for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.color import registration
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import ColorFrame, ColorSamples
from taccel_lab.calibration.color.registration import register_presses
from taccel_lab.calibration.surfaces import BallSurface
from taccel_lab.calibration.surfaces.moved_press import MovedPress
from taccel_lab.calibration.surfaces.radial import MARGIN, RadialSurfaces
from taccel_lab.calibration.training import going_on
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from tests.calibration.drawn.faults import poison, quantise
from tests.support.analytic_surface import analytic_surface
from tests.support.synthetic_presses import BALL_RADIUS_MM, GRID, synthetic_captures

COUNT = 12
THREE_SCALES = (0.95, 1.0, 1.05)
QUICK = ColorFitOptions(
    hidden=(24, 24), steps=200, batch_pixels=1024, disc_pixels=800, ring_pixels=500,
    far_pixels=100, learning_rate=1e-2,
)  # fmt: skip

BRIEF = replace(QUICK, steps=60)
"""For what holds after any number of steps."""


def clicked_frames(
    captures: CaptureSet, rng: np.random.Generator, off_px: float, scale: float
) -> list[ColorFrame]:
    """The presses with circles that are off, and surfaces as if they were right."""
    frames = []
    for press in captures.presses:
        assert press.circle is not None
        shift = rng.normal(0, off_px, 2)
        circle = ContactCircle(
            press.circle.u_px + float(shift[0]),
            press.circle.v_px + float(shift[1]),
            press.circle.radius_px * scale,
        )
        frames.append(ColorFrame(press.name, press.image(), circle, simulated(circle)))
    return frames


def simulated(circle: ContactCircle) -> BallSurface:
    return analytic_surface(circle, GRID, BALL_RADIUS_MM, decay_mm=1.0)


def errors(captures: CaptureSet, circles: list[ContactCircle]) -> np.ndarray:
    """Found minus true u, v and radius, shape [press, 3]."""
    return np.array(
        [
            (c.u_px - p.circle.u_px, c.v_px - p.circle.v_px, c.radius_px - p.circle.radius_px)
            for c, p in zip(circles, captures.presses, strict=True)
            if p.circle is not None
        ]
    )


@pytest.fixture(scope="module")
def captures() -> CaptureSet:
    return synthetic_captures(COUNT, noise=1.0)[0]


def test_circles_that_are_off_come_back(captures: CaptureSet) -> None:
    frames = clicked_frames(captures, np.random.default_rng(1), off_px=1.5, scale=1.1)
    found = register_presses(frames, captures.background, GRID, fit=QUICK)
    before = errors(captures, [frame.circle for frame in frames])
    after = errors(captures, found.circles)
    assert np.hypot(*after[:, :2].T).mean() < 0.65 * np.hypot(*before[:, :2].T).mean()
    assert 0.85 < found.scale < 0.96
    assert np.abs(after[:, 2]).mean() < 0.5 * np.abs(before[:, 2]).mean()


def test_circles_that_are_right_stay(captures: CaptureSet) -> None:
    frames = clicked_frames(captures, np.random.default_rng(2), off_px=0.0, scale=1.0)
    found = register_presses(frames, captures.background, GRID, fit=QUICK)
    after = errors(captures, found.circles)
    assert abs(found.scale - 1) < 0.04
    assert np.hypot(*after[:, :2].T).mean() < 0.3
    assert np.abs(after[:, 2]).mean() < 0.4


def test_masked_pixels_have_no_effect_and_runs_agree(
    captures: CaptureSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = clicked_frames(captures, np.random.default_rng(4), off_px=1.0, scale=1.0)[:8]
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[50:60, 60:100] = False
    rng = np.random.default_rng(5)
    poisoned = [replace(f, image=quantise(poison(f.image, mask, rng))) for f in frames]
    monkeypatch.setattr(registration, "ROUNDS", 1)
    clean, dirty = (
        register_presses(
            given, captures.background, GRID, mask=mask, fit=BRIEF, scales=THREE_SCALES
        )
        for given in (frames, poisoned)
    )
    assert clean.circles == dirty.circles


def test_fits_go_on_from_the_first_of_their_fold(
    captures: CaptureSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Later fits are short, and none has seen the presses that it is asked about."""
    started: list[tuple[int, bool, int]] = []
    real = registration.train

    def counted(
        samples: ColorSamples, grid: PixelGrid, options: ColorFitOptions, **more: Any
    ) -> Any:
        started.append((options.steps, more.get("start") is None, len(samples.change)))
        return real(samples, grid, options, **more)

    monkeypatch.setattr(registration, "train", counted)
    frames = clicked_frames(captures, np.random.default_rng(7), off_px=1.0, scale=1.0)
    register_presses(frames, captures.background, GRID, fit=BRIEF, scales=THREE_SCALES)
    whole = [steps for steps, fresh, _ in started if fresh]
    assert whole == [BRIEF.steps] * registration.FOLDS
    again = {steps for steps, fresh, _ in started if not fresh}
    assert again == {going_on(BRIEF).steps}
    pixels = sorted({count for _, _, count in started})
    assert pixels[-1] < 0.6 * COUNT * 1400


def test_too_few_presses_are_refused(captures: CaptureSet) -> None:
    frames = clicked_frames(captures, np.random.default_rng(6), off_px=0.0, scale=1.0)
    with pytest.raises(InputError, match="7 presses are too few"):
        register_presses(frames[:7], captures.background, GRID)


FINE_GRID = PixelGrid(160, 120, 0.08, 0.08)
BALL_MM = 2.0
CIRCLES = [
    ContactCircle(45.0 + 7 * i, 50.0 + 3 * (i % 4), radius)
    for i, radius in enumerate((12.0, 13.5, 15.0, 16.0, 17.5, 18.5, 20.0, 21.0))
]


def press(circle: ContactCircle) -> BallSurface:
    return analytic_surface(circle, FINE_GRID, BALL_MM, decay_mm=1.0)


def leaning(surface: BallSurface) -> BallSurface:
    """The same dent in a gel that leans at rest."""
    slope = np.array([0.08, -0.05])
    v, u = np.mgrid[: FINE_GRID.height_px, : FINE_GRID.width_px]
    plane = (slope[0] * u * FINE_GRID.mm_per_px_x + slope[1] * v * FINE_GRID.mm_per_px_y) * 1e-3

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
def simulated_presses(lean: bool) -> tuple[list[BallSurface], RadialSurfaces]:
    surfaces = [press(circle) for circle in CIRCLES]
    if lean:
        surfaces = [leaning(surface) for surface in surfaces]
    return surfaces, RadialSurfaces.of(surfaces, CIRCLES, FINE_GRID)


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
    surfaces, library = simulated_presses(lean)
    make = leaning if lean else (lambda surface: surface)
    start = CIRCLES[which]
    wanted = ContactCircle(start.u_px + du, start.v_px + dv, start.radius_px * grown)
    truth = make(press(wanted))
    near = np.flatnonzero(wanted.distance_px(FINE_GRID) < 2.0 * wanted.radius_px)
    normals, sunk = MovedPress.of(surfaces[which], start, library).at(wanted, near)
    apart = angle_deg(normals, truth.normals.reshape(-1, 3)[near])
    still = angle_deg(
        surfaces[which].normals.reshape(-1, 3)[near], truth.normals.reshape(-1, 3)[near]
    )
    assert apart.mean() < 0.6
    assert apart.mean() < 0.02 + still.mean()
    assert np.abs(sunk - truth.displacement_mm().reshape(-1)[near]).mean() < 0.012


def test_radii_stay_near_those_simulated() -> None:
    _, library = simulated_presses(False)
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
        RadialSurfaces.of([], [], FINE_GRID)
