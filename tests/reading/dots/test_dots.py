# SPDX-License-Identifier: Apache-2.0
"""Dots of drawn pictures: exact without noise, within their own sigma with it, flagged when odd."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.reading.dots import soft_ellipse as model
from taccel_lab.reading.dots.detection import DotFlag
from taccel_lab.reading.dots.marker_picture import (
    MarkerPicture,
    find_markers,
    marker_pitch_px,
)
from tests.calibration.drawn.dots import (
    HEIGHT,
    WIDTH,
    draw_dots,
    grid_points,
    nearest,
    picture,
)
from tests.calibration.drawn.faults import add_dust, add_gradient, vignette

GRID = grid_points()
JITTERED = grid_points(turn_rad=0.03) + np.random.default_rng(1).uniform(-0.5, 0.5, GRID.shape)


def located(image: np.ndarray, true: np.ndarray) -> tuple[MarkerPicture, np.ndarray, np.ndarray]:
    """What is found of a picture, the dot that each is of, and the way to it; of every dot one."""
    found = find_markers(image)
    index, error = nearest(found.dots.uv_px, true)
    assert sorted(index) == list(range(len(true)))
    return found, index, error


def test_derivatives_of_the_dot_model_are_those_of_its_levels() -> None:
    p = np.array([[0.3, -0.4, 0.21, 0.02, 0.18, np.log(0.9), -0.8, 150.0, 0.4, -0.3]])
    uv = np.stack(np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)), axis=-1).reshape(-1, 2)
    _, jacobian = model.evaluate(p, uv.astype(float))
    for k, step in enumerate(1e-5 * np.eye(model.PARAMETERS)):
        ahead, behind = model.evaluate(p + step, uv)[0], model.evaluate(p - step, uv)[0]
        np.testing.assert_allclose(jacobian[..., k], (ahead - behind) / 2e-5, atol=2e-4)


def test_levels_in_single_precision_are_those_of_double() -> None:
    """Also far from the dot, where the edge's bell is smaller than single precision holds."""
    p = np.array([[0.3, -0.4, 0.21, 0.02, 0.18, np.log(0.3), -0.8, 150.0, 0.4, -0.3]])
    uv = np.stack(np.meshgrid(np.arange(-30, 31), np.arange(-30, 31)), axis=-1).reshape(-1, 2)
    double, single = (model.evaluate(p, uv.astype(kind)) for kind in (np.float64, np.float32))
    for exact, fast in zip(double, single, strict=True):
        assert fast.dtype == np.float32
        assert np.abs(fast - exact).max() < 2e-6 * np.abs(exact).max()
        assert not ((fast != 0) & (np.abs(fast) < np.finfo(np.float32).tiny)).any()


@pytest.mark.parametrize("radius", [2.0, 3.0, 5.5, 9.0])
@pytest.mark.parametrize("blur_px", [0.0, 0.8])
def test_perfect_dots_are_found_to_a_hundredth_of_a_pixel(radius: float, blur_px: float) -> None:
    image = picture(JITTERED, radius, blur_px=blur_px, levels=False)
    found, _, error = located(image, JITTERED)
    assert np.abs(error).max() <= 0.01
    assert (found.dots.flags == 0).all()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("noise", "sign", "around", "paint"),
    [(1.0, -1, 160.0, 25.0), (4.0, -1, 160.0, 25.0), (3.0, 1, 90.0, 220.0)],
)
def test_noisy_dots_lie_within_their_own_sigma(noise, sign, around, paint) -> None:
    standardised = []
    for seed in range(3):
        image = picture(JITTERED, 5.0, noise=noise, seed=seed, background=around, dot=paint)
        found, _, error = located(image, JITTERED)
        assert found.dots.scale.sign == sign
        standardised.append(error / found.dots.sigma_px)
    z = np.concatenate(standardised)
    # 378 numbers: their root mean square is 1 to 4 %.
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.15)
    assert (np.abs(z) < 1.96).mean() > 0.92


def test_uneven_light_dust_and_a_gradient_move_no_dot() -> None:
    rng = np.random.default_rng(4)
    shaded = add_gradient(vignette(picture(JITTERED, levels=False), 0.6), 30.0, -25.0)
    shaded = add_dust(shaded, 15, rng, radius_px=1.2, levels=-25.0)
    found = find_markers(shaded + rng.normal(0.0, 1.0, shaded.shape))
    index, error = nearest(found.dots.uv_px[found.lattice.numbered], JITTERED)
    assert sorted(index) == list(range(len(JITTERED)))
    # A speck may sit on a dot's rim; the others stay put.
    assert np.percentile(np.abs(error), 90) < 0.03 and np.abs(error).max() < 0.5


def test_contact_colours_leave_dots_alone() -> None:
    paint = draw_dots(WIDTH, HEIGHT, JITTERED, 5.0, background=1.0, dot=0.1)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    bump = np.exp(-((u - 150.0) ** 2 + (v - 110.0) ** 2) / (2 * 35.0**2))
    ripples = np.stack([90 * np.sin(u / 9), -60 + 0 * u, 80 * np.cos(v / 12)], axis=-1)
    light = (130, 130, 120) + ripples * bump[..., None]
    dots = find_markers(light * paint[..., None]).dots
    index, error = nearest(dots.uv_px[dots.whole], JITTERED)
    assert len(set(index)) == len(JITTERED)
    assert np.median(np.abs(error)) < 0.02 and np.abs(error).max() < 0.15


def test_dots_cut_by_the_border_are_flagged_and_placed() -> None:
    true = grid_points(9, 11, centre=(160.0, 119.5))
    found = find_markers(picture(true, noise=1.0))
    index, error = nearest(found.dots.uv_px, true)
    cut = found.dots.flagged(DotFlag.CUT)
    u, v = true[index].T
    beyond = np.minimum.reduce([u, v, WIDTH - 1 - u, HEIGHT - 1 - v])
    assert set(np.flatnonzero(beyond < 3.5)) <= set(np.flatnonzero(cut))
    assert not cut[beyond > 6.0].any()
    assert np.abs(error[beyond >= 0]).max() < 0.25 and np.abs(error[~cut]).max() < 0.05


@pytest.mark.parametrize("apart", [(6.0, 1.0), (7.5, 2.0), (9.5, -3.0)])
def test_touching_dots_are_split_and_flagged(apart: tuple[float, float]) -> None:
    together = GRID.copy()
    together[30] = GRID[31] - apart
    found, index, error = located(picture(together, noise=1.0), together)
    assert set(index[found.dots.flagged(DotFlag.MERGED)]) == {30, 31}
    assert np.abs(error).max() < 0.1
    assert np.abs(error[~np.isin(index, [30, 31])]).max() < 0.05


def test_missing_dots_are_listed() -> None:
    gone = [10, 24, 25, 50]
    found = find_markers(picture(np.delete(GRID, gone, axis=0), noise=1.0))
    assert {r * 9 + c for r, c in found.layout_px.missing} == set(gone)


@pytest.mark.thorough
def test_pictures_without_dots_and_bad_ones_are_refused() -> None:
    rng = np.random.default_rng(5)
    points: list[np.ndarray] = []
    while len(points) < 40:
        new = rng.uniform((15, 15), (WIDTH - 15, HEIGHT - 15))
        if all(np.hypot(*(new - p)) > 20 for p in points):
            points.append(new)
    rng = np.random.default_rng(0)
    smooth = vignette(np.full((HEIGHT, WIDTH), 150.0), 0.5)
    noisy, dusty = smooth + rng.normal(0, 8, smooth.shape), smooth
    for size in np.geomspace(0.8, 4.0, 12):
        dusty = add_dust(dusty, 2, rng, radius_px=float(size), levels=-20.0 * float(size))
    for image, words in (
        (picture(np.array(points), noise=1.0), "no dots found: the 40 blobs .* form no square"),
        (smooth, "no dots found"),
        (noisy, "no dots found"),
        (dusty + rng.normal(0, 1, smooth.shape), "no dots found"),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint8), "no dots found"),
        (np.zeros((20, 20), np.uint8), "too small"),
        (np.zeros((60, 60, 2), np.uint8), "grey or RGB"),
        (np.full((60, 60), np.nan), "not finite"),
    ):
        with pytest.raises(InputError, match=words):
            find_markers(image)


def test_pitch_is_that_of_the_drawing_within_its_sigma() -> None:
    true = grid_points(pitch=(30.0, 29.0), turn_rad=0.05)
    *pitch, sigma = marker_pitch_px(picture(true, 4.0, noise=2.0))
    assert sigma < 0.01
    assert pitch == pytest.approx((30.0, 29.0), abs=4 * sigma)


@pytest.mark.thorough
def test_large_pictures_with_large_dots_are_no_harder() -> None:
    true = grid_points(5, 6, (200.0, 190.0), turn_rad=0.04, centre=(640.0, 480.0))
    image = draw_dots(1281, 963, true, 45.0) + np.random.default_rng(0).normal(0, 3, (963, 1281))
    found, _, error = located(image, true)
    assert np.abs(error).max() < 0.1
    assert np.sqrt(((error / found.dots.sigma_px) ** 2).mean()) < 1.5
    assert np.median(found.dots.radius_px) == pytest.approx(45.0, abs=0.3)
