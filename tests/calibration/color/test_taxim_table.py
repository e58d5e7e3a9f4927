# SPDX-License-Identifier: Apache-2.0
"""Taxim's table: what made the images is found again, bins without pixels borrow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.color import taxim_table
from taccel_lab.calibration.color.taxim_table import nearest_filled, render_taxim_table
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import TaximTable, bin_indices
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.light import LightDrift
from taccel_lab.signals.normals import normals_from_slopes
from tests.calibration.drawn.faults import poison
from tests.support.analytic_surface import analytic_surface

GRID = PixelGrid(120, 90, 0.1, 0.1)
BINS = 12
CIRCLES = [ContactCircle(u, v, r) for u in (25.0, 45.0, 60.0, 80.0, 95.0)
           for v in (25.0, 45.0, 65.0) for r in (14.0, 17.0)]  # fmt: skip
STILL = LightDrift(np.ones(3), np.zeros(3))
BACKGROUND = np.full((GRID.height_px, GRID.width_px, 3), 120.0, dtype=np.float32)
SCENE = CaptureScene(BACKGROUND, GRID, 2.0)


def true_table(rng: np.random.Generator) -> TaximTable:
    """Random quadratics of which no term outweighs the others within the image."""
    scale = np.array([GRID.width_px**2, GRID.height_px**2, GRID.width_px * GRID.height_px,
                      GRID.width_px, GRID.height_px, 1.0])  # fmt: skip
    grad = rng.uniform(-15, 15, (3, BINS, BINS, 6)) / scale
    grad[:, 0] = 0.0  # untouched gel lies there
    return TaximTable(BINS, grad)


def surface_of(circle: ContactCircle) -> BallSurface:
    return analytic_surface(circle, GRID, 2.0, decay_mm=1.0)


def frames_of(seed: int, drift: LightDrift = STILL) -> list[PressFrame]:
    """Presses in the colours of a random table."""
    table, frames = true_table(np.random.default_rng(seed)), []
    for i, circle in enumerate(CIRCLES):
        surface = surface_of(circle)
        image = drift.apply(120.0 + table.change(surface.normals))
        frames.append(PressFrame(f"p{i}", image, circle, surface))
    return frames


@pytest.fixture(autouse=True)
def coarse_bins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(taxim_table, "BINS", BINS)


def fitted(
    frames: list[PressFrame], scene: CaptureScene = SCENE, drift: LightDrift = STILL
) -> TaximTable:
    return taxim_table.fit_taxim_table(frames, scene, {frame.name: drift for frame in frames})


def within(frame: PressFrame, radii: float = 1.0) -> np.ndarray:
    return frame.circle.distance_px(GRID) <= radii * frame.circle.radius_px


def test_the_table_that_made_the_images_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(taxim_table, "RIDGE", 1e-12)
    circle = ContactCircle(52.0, 41.0, 15.0)
    surface = surface_of(circle)
    wanted = 120.0 + true_table(np.random.default_rng(0)).change(surface.normals)
    rendered = render_taxim_table(fitted(frames_of(0)), surface, BACKGROUND)
    disc = circle.distance_px(GRID) <= circle.radius_px
    assert np.abs(rendered - wanted)[disc].mean() < 0.05


def test_the_pull_keeps_the_images_near_and_the_far_side_tame() -> None:
    frames = [frame for frame in frames_of(1) if frame.circle.u_px < 50]
    rng = np.random.default_rng(2)
    noisy = [replace(f, image=f.image + rng.normal(0, 2, f.image.shape)) for f in frames]
    tame, far = fitted(noisy), surface_of(ContactCircle(95.0, 45.0, 15.0))
    assert np.abs(tame.change(far.normals)).max() < 60
    error = 120.0 + tame.change(frames[4].surface.normals) - frames[4].image
    assert np.abs(error)[within(frames[4])].mean() < 1.5


@pytest.mark.thorough
def test_drift_is_taken_off_and_masked_pixels_have_no_effect() -> None:
    drift = LightDrift(np.array([1.1, 0.9, 1.0]), np.array([5.0, -5.0, 3.0]))
    plain = frames_of(3)
    two = fitted(frames_of(3, drift), drift=drift)
    assert two.grad_rgb == pytest.approx(fitted(plain).grad_rgb, abs=1e-9)
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[30:50, 40:60] = False
    rng = np.random.default_rng(4)
    poisoned = [replace(frame, image=poison(frame.image, mask, rng)) for frame in plain]
    clean, dirty = (fitted(some, replace(SCENE, mask=mask)) for some in (plain, poisoned))
    assert np.array_equal(clean.grad_rgb, dirty.grad_rgb)
    with pytest.raises(InputError, match="no usable pixel"):
        fitted(plain, replace(SCENE, mask=np.zeros_like(mask)))


def test_empty_bins_take_over_their_nearest_even_around_the_circle() -> None:
    filled = np.zeros((8, 8), dtype=bool)
    filled[3, 7] = filled[6, 2] = True
    nearest = nearest_filled(filled).reshape(8, 8)
    assert nearest[3, 7] == 3 * 8 + 7 and nearest[6, 2] == 6 * 8 + 2
    # Direction 0 lies beside direction 7: the circle closes.
    assert nearest[3, 0] == 3 * 8 + 7 and nearest[7, 3] == 6 * 8 + 2


def test_untouched_gel_shows_the_background() -> None:
    assert bin_indices(np.array([[0.0, 0.0, 1.0]]), BINS)[0][0] == 0
    # Captures whose dents are darker at the floor, too: it must not end up on untouched gel.
    darker = [
        replace(f, image=f.image - 30.0 * (f.circle.distance_px(GRID) < 10)[..., None])
        for f in frames_of(5)
    ]
    surface = darker[0].surface
    still = replace(surface, normals=surface.rest_normals, height_m=surface.rest_height_m)
    assert np.array_equal(render_taxim_table(fitted(darker), still, BACKGROUND), BACKGROUND)


def test_the_surroundings_keep_their_own_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dents whose floors are darker than gel of the same slope around them leave no halo."""
    frames = frames_of(7)
    darker = [replace(f, image=f.image - 25.0 * within(f)[..., None]) for f in frames]
    ring, error = within(frames[0], 2.0) & ~within(frames[0], 1.1), []
    for reach in (1.0, 2.5):
        monkeypatch.setattr(taxim_table, "REACH_RADII", reach)
        shown = render_taxim_table(fitted(darker), frames[0].surface, BACKGROUND)
        error.append(np.abs(shown - frames[0].image)[ring].mean())
    assert error[1] < 0.6 * error[0], error


@pytest.mark.thorough
def test_slopes_count_over_a_leaning_rest() -> None:
    """The same slopes over rest, on flat and on leaning gel, give the same table and image."""
    lean, frames, leaning = np.array([0.15, -0.1]), frames_of(6), []
    for frame in frames:
        normals = frame.surface.normals
        tilted = normals_from_slopes(lean - normals[..., :2] / normals[..., 2:])
        rest = np.broadcast_to(normals_from_slopes(lean), normals.shape)
        surface = replace(frame.surface, normals=tilted, rest_normals=rest)
        leaning.append(replace(frame, surface=surface))
    flat, tilted = (
        render_taxim_table(fitted(some), some[0].surface, BACKGROUND) for some in (frames, leaning)
    )
    # Rounding moves a few pixels to the neighbouring bin.
    assert (np.abs(flat - tilted) > 0.1).mean() < 0.01
