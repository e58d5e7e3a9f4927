# SPDX-License-Identifier: Apache-2.0
"""Taxim's table: what made the images is found again, bins without pixels borrow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.color import taxim_table
from taccel_lab.calibration.color.taxim_table import (
    fit_taxim_table,
    nearest_filled,
    render_taxim_table,
)
from taccel_lab.calibration.frame_light import LightDrift
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import TaximTable, bin_indices
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normals import normals_from_slopes
from tests.calibration.drawn.faults import poison
from tests.support.analytic_surface import analytic_surface

GRID = PixelGrid(120, 90, 0.1, 0.1)
BINS = 12
PLACES = [(u, v, r) for u in (25.0, 45.0, 60.0, 80.0, 95.0) for v in (25.0, 45.0, 65.0)
          for r in (14.0, 17.0)]  # fmt: skip
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


def frames_of(table: TaximTable, drift: LightDrift = STILL) -> list[PressFrame]:
    frames = []
    for i, (u, v, r) in enumerate(PLACES):
        circle = ContactCircle(u, v, r)
        surface = analytic_surface(circle, GRID, 2.0, decay_mm=1.0)
        image = drift.apply(120.0 + table.change(surface.normals))
        frames.append(PressFrame(f"p{i}", image, circle, surface))
    return frames


@pytest.fixture(autouse=True)
def coarse_bins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(taxim_table, "BINS", BINS)


def lights(frames: list[PressFrame], drift: LightDrift = STILL) -> dict[str, LightDrift]:
    return {frame.name: drift for frame in frames}


def test_the_table_that_made_the_images_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(taxim_table, "RIDGE", 1e-12)
    truth = true_table(np.random.default_rng(0))
    frames = frames_of(truth)
    found = fit_taxim_table(frames, SCENE, lights(frames))
    circle = ContactCircle(52.0, 41.0, 15.0)
    surface = analytic_surface(circle, GRID, 2.0, decay_mm=1.0)
    disc = circle.distance_px(GRID) <= circle.radius_px
    wanted = 120.0 + truth.change(surface.normals)
    rendered = render_taxim_table(found, surface, BACKGROUND)
    assert np.abs(rendered - wanted)[disc].mean() < 0.05


def test_the_pull_keeps_the_images_near_and_the_far_side_tame() -> None:
    truth = true_table(np.random.default_rng(1))
    frames = [f for f, place in zip(frames_of(truth), PLACES, strict=True) if place[0] < 50]
    rng = np.random.default_rng(2)
    noisy = [replace(f, image=f.image + rng.normal(0, 2, f.image.shape)) for f in frames]
    tame = fit_taxim_table(noisy, SCENE, lights(frames))
    far = analytic_surface(ContactCircle(95.0, 45.0, 15.0), GRID, 2.0, decay_mm=1.0)
    assert np.abs(tame.change(far.normals)).max() < 60
    near = frames[4]
    disc = near.circle.distance_px(GRID) <= near.circle.radius_px
    error = 120.0 + tame.change(near.surface.normals) - near.image
    assert np.abs(error)[disc].mean() < 1.5


@pytest.mark.thorough
def test_drift_is_taken_off_and_masked_pixels_have_no_effect() -> None:
    truth = true_table(np.random.default_rng(3))
    drift = LightDrift(np.array([1.1, 0.9, 1.0]), np.array([5.0, -5.0, 3.0]))
    plain, drifted = frames_of(truth), frames_of(truth, drift)
    one = fit_taxim_table(plain, SCENE, lights(plain))
    two = fit_taxim_table(drifted, SCENE, lights(drifted, drift))
    assert two.grad_rgb == pytest.approx(one.grad_rgb, abs=1e-9)
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[30:50, 40:60] = False
    rng = np.random.default_rng(4)
    poisoned = [replace(frame, image=poison(frame.image, mask, rng)) for frame in plain]
    clean = fit_taxim_table(plain, replace(SCENE, mask=mask), lights(plain))
    dirty = fit_taxim_table(poisoned, replace(SCENE, mask=mask), lights(plain))
    assert np.array_equal(clean.grad_rgb, dirty.grad_rgb)
    with pytest.raises(InputError, match="no usable pixel"):
        fit_taxim_table(plain, replace(SCENE, mask=np.zeros_like(mask)), lights(plain))


def test_empty_bins_take_over_their_nearest_even_around_the_circle() -> None:
    filled = np.zeros((8, 8), dtype=bool)
    filled[3, 7] = filled[6, 2] = True
    nearest = nearest_filled(filled).reshape(8, 8)
    assert nearest[3, 7] == 3 * 8 + 7 and nearest[6, 2] == 6 * 8 + 2
    # Direction 0 lies beside direction 7: the circle closes.
    assert nearest[3, 0] == 3 * 8 + 7 and nearest[7, 3] == 6 * 8 + 2


def test_untouched_gel_shows_the_background() -> None:
    tilt, _ = bin_indices(np.array([[0.0, 0.0, 1.0]]), BINS)
    assert tilt[0] == 0
    # Captures whose dents are darker at the floor, too: it must not end up on untouched gel.
    frames = frames_of(true_table(np.random.default_rng(5)))
    darker = [
        replace(f, image=f.image - 30.0 * (f.circle.distance_px(GRID) < 10)[..., None])
        for f in frames
    ]
    found = fit_taxim_table(darker, SCENE, lights(darker))
    surface = frames[0].surface
    still = replace(surface, normals=surface.rest_normals, height_m=surface.rest_height_m)
    assert np.array_equal(render_taxim_table(found, still, BACKGROUND), BACKGROUND)


def test_the_surroundings_keep_their_own_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dents whose floors are darker than gel of the same slope around them leave no halo."""
    frames = frames_of(true_table(np.random.default_rng(7)))
    darker = []
    for f in frames:
        inside = (f.circle.distance_px(GRID) <= f.circle.radius_px)[..., None]
        darker.append(replace(f, image=np.where(inside, f.image - 25.0, f.image)))
    around = frames[0].circle.distance_px(GRID) / frames[0].circle.radius_px
    ring = (around > 1.1) & (around < 2.0)
    error = []
    for reach in (1.0, 2.5):
        monkeypatch.setattr(taxim_table, "REACH_RADII", reach)
        found = fit_taxim_table(darker, SCENE, lights(darker))
        shown = render_taxim_table(found, frames[0].surface, BACKGROUND)
        error.append(np.abs(shown - frames[0].image)[ring].mean())
    assert error[1] < 0.6 * error[0], error


@pytest.mark.thorough
def test_slopes_count_over_a_leaning_rest() -> None:
    """The same slopes over rest, on flat and on leaning gel, give the same table and image."""
    frames = frames_of(true_table(np.random.default_rng(6)))
    lean = normals_from_slopes(np.array([0.15, -0.1]))
    leaning = []
    for frame in frames:
        slope = -frame.surface.normals[..., :2] / frame.surface.normals[..., 2:] + [0.15, -0.1]
        surface = replace(
            frame.surface,
            normals=normals_from_slopes(slope),
            rest_normals=np.broadcast_to(lean, frame.surface.normals.shape),
        )
        leaning.append(replace(frame, surface=surface))
    one = fit_taxim_table(frames, SCENE, lights(frames))
    two = fit_taxim_table(leaning, SCENE, lights(frames))
    flat = render_taxim_table(one, frames[0].surface, BACKGROUND)
    tilted = render_taxim_table(two, leaning[0].surface, BACKGROUND)
    # Rounding moves a few pixels to the neighbouring bin.
    assert (np.abs(flat - tilted) > 0.1).mean() < 0.01
