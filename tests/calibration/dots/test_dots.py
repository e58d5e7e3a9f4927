# SPDX-License-Identifier: Apache-2.0
"""Dots of drawn pictures: exact without noise, within their own sigma with it, flagged when odd."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.dots import soft_ellipse as model
from taccel_lab.calibration.dots.detection import DotFlag
from taccel_lab.calibration.dots.marker_picture import find_markers, marker_pitch_px
from taccel_lab.errors import InputError
from tests.calibration.drawn.discs import disc_coverage, draw_dots
from tests.calibration.drawn.dot_grids import HEIGHT, WIDTH, grid_points, nearest, picture
from tests.calibration.drawn.faults import add_dust, add_gradient, vignette


def jittered(seed: int = 1, **grid: object) -> np.ndarray:
    points = grid_points(turn_rad=0.03, **grid)  # type: ignore[arg-type]
    return points + np.random.default_rng(seed).uniform(-0.5, 0.5, points.shape)


def test_a_drawn_disc_covers_its_exact_area() -> None:
    whole = disc_coverage(40, 40, (19.3, 20.7), 7.3)
    assert whole.sum() == pytest.approx(np.pi * 7.3**2, rel=1e-12)
    # A pixel in the middle of the disc's straight cut, by fine sampling.
    fine = np.linspace(-0.5, 0.5, 2001)[:-1] + 0.5 / 2000
    u, v = np.meshgrid(26.0 + fine, 21.0 + fine)
    inside = (u - 19.3) ** 2 + (v - 20.7) ** 2 < 7.3**2
    assert whole[21, 26] == pytest.approx(inside.mean(), abs=2e-4)
    cut = disc_coverage(20, 20, (0.0, 10.0), 5.0)
    assert cut.sum() == pytest.approx(np.pi * 25 / 2 + 0.5 * 10.0, rel=2e-3)


def test_derivatives_of_the_dot_model_are_those_of_its_levels() -> None:
    p = np.array([[0.3, -0.4, 0.21, 0.02, 0.18, np.log(0.9), -0.8, 150.0, 0.4, -0.3]])
    uv = np.stack(np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)), axis=-1).reshape(-1, 2)
    _, jacobian = model.evaluate(p, uv.astype(float))
    for k in range(model.PARAMETERS):
        step = np.zeros_like(p)
        step[0, k] = 1e-5
        ahead, behind = model.evaluate(p + step, uv)[0], model.evaluate(p - step, uv)[0]
        np.testing.assert_allclose(jacobian[..., k], (ahead - behind) / 2e-5, atol=2e-4)


@pytest.mark.parametrize("radius", [2.0, 3.0, 5.5, 9.0])
@pytest.mark.parametrize("blur_px", [0.0, 0.8])
def test_perfect_dots_are_found_to_a_hundredth_of_a_pixel(radius: float, blur_px: float) -> None:
    true = jittered()
    dots = find_markers(picture(true, radius, blur_px=blur_px, levels=False)).dots
    index, error = nearest(dots.uv_px, true)
    assert sorted(index) == list(range(len(true)))
    assert np.abs(error).max() <= 0.01
    assert (dots.flags == 0).all()


@pytest.mark.thorough
@pytest.mark.parametrize(("noise", "dark"), [(1.0, True), (4.0, True), (3.0, False)])
def test_noisy_dots_lie_within_their_own_sigma(noise: float, dark: bool) -> None:
    true = jittered()
    around, paint = (160.0, 25.0) if dark else (90.0, 220.0)
    standardised = []
    for seed in range(3):
        dots = find_markers(
            picture(true, 5.0, noise=noise, seed=seed, background=around, dot=paint)
        ).dots
        index, error = nearest(dots.uv_px, true)
        assert sorted(index) == list(range(len(true)))
        assert dots.scale.sign == (-1 if dark else 1)
        standardised.append(error / dots.sigma_px)
    z = np.concatenate(standardised)
    # 378 numbers: their root mean square is 1 to 4 %.
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.15)
    assert (np.abs(z) < 1.96).mean() > 0.92


def test_uneven_light_dust_and_a_gradient_move_no_dot() -> None:
    true = jittered()
    image = picture(true, 5.0, levels=False)
    rng = np.random.default_rng(4)
    shaded = add_gradient(vignette(image, 0.6), 30.0, -25.0)
    shaded = add_dust(shaded, 15, rng, radius_px=1.2, levels=-25.0)
    shaded = shaded + rng.normal(0.0, 1.0, shaded.shape)
    picture_found = find_markers(shaded)
    numbered = picture_found.lattice.numbered
    index, error = nearest(picture_found.dots.uv_px[numbered], true)
    assert sorted(index) == list(range(len(true)))
    # A speck may sit on a dot's rim; the others stay put.
    assert np.percentile(np.abs(error), 90) < 0.03
    assert np.abs(error).max() < 0.5


def test_contact_colours_leave_dots_alone() -> None:
    true = jittered()
    paint = draw_dots(WIDTH, HEIGHT, true, 5.0, background=1.0, dot=0.1)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    bump = np.exp(-((u - 150.0) ** 2 + (v - 110.0) ** 2) / (2 * 35.0**2))
    light = np.stack(
        [130 + 90 * bump * np.sin(u / 9), 130 - 60 * bump, 120 + 80 * bump * np.cos(v / 12)], -1
    )
    dots = find_markers(light * paint[..., None]).dots
    index, error = nearest(dots.uv_px[dots.whole], true)
    assert len(set(index)) == len(true)
    assert np.median(np.abs(error)) < 0.02
    assert np.abs(error).max() < 0.15


def test_dots_cut_by_the_border_are_flagged_and_placed() -> None:
    true = grid_points(9, 11, centre=(160.0, 119.5))
    found = find_markers(picture(true, 5.0, noise=1.0))
    index, error = nearest(found.dots.uv_px, true)
    cut = found.dots.flagged(DotFlag.CUT)
    u, v = true[index].T
    beyond = np.minimum.reduce([u, v, WIDTH - 1 - u, HEIGHT - 1 - v])
    assert set(np.flatnonzero(beyond < 3.5)) <= set(np.flatnonzero(cut))
    assert not cut[beyond > 6.0].any()
    assert np.abs(error[beyond >= 0]).max() < 0.25
    assert np.abs(error[~cut]).max() < 0.05


@pytest.mark.parametrize("apart", [(6.0, 1.0), (7.5, 2.0), (9.5, -3.0)])
def test_touching_dots_are_split_and_flagged(apart: tuple[float, float]) -> None:
    true = grid_points()
    together = true.copy()
    together[30] = true[31] - apart
    found = find_markers(picture(together, 5.0, noise=1.0))
    index, error = nearest(found.dots.uv_px, together)
    assert sorted(index) == list(range(len(true)))
    assert np.abs(error).max() < 0.1
    assert set(index[found.dots.flagged(DotFlag.MERGED)]) == {30, 31}
    alone = np.setdiff1d(np.arange(len(true)), [30, 31])
    assert np.abs(error[np.isin(index, alone)]).max() < 0.05


def test_missing_dots_are_listed() -> None:
    gone = [10, 24, 25, 50]
    found = find_markers(picture(np.delete(grid_points(), gone, axis=0), 5.0, noise=1.0))
    assert {r * 9 + c for r, c in found.layout_px.missing} == set(gone)


@pytest.mark.thorough
def test_dots_in_no_lattice_are_refused() -> None:
    rng = np.random.default_rng(5)
    points: list[np.ndarray] = []
    while len(points) < 40:
        new = rng.uniform((15, 15), (WIDTH - 15, HEIGHT - 15))
        if all(np.hypot(*(new - p)) > 20 for p in points):
            points.append(new)
    with pytest.raises(InputError, match=r"no dots found: the 40 blobs .* form no square"):
        find_markers(picture(np.array(points), 5.0, noise=1.0))


@pytest.mark.thorough
def test_pictures_without_dots_and_bad_ones_are_refused() -> None:
    rng = np.random.default_rng(0)
    smooth = vignette(np.full((HEIGHT, WIDTH), 150.0), 0.5)
    noisy, dusty = smooth + rng.normal(0, 8, smooth.shape), smooth
    for size in np.geomspace(0.8, 4.0, 12):
        dusty = add_dust(dusty, 2, rng, radius_px=float(size), levels=-20.0 * float(size))
    dusty = dusty + rng.normal(0, 1, smooth.shape)
    for image, words in (
        (smooth, "no dots found"),
        (noisy, "no dots found"),
        (dusty, "no dots found"),
        (np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8), "no dots found"),
        (np.zeros((20, 20), dtype=np.uint8), "too small"),
        (np.zeros((60, 60, 2), dtype=np.uint8), "grey or RGB"),
        (np.full((60, 60), np.nan), "not finite"),
    ):
        with pytest.raises(InputError, match=words):
            find_markers(image)


def test_pitch_is_that_of_the_drawing_within_its_sigma() -> None:
    true = grid_points(pitch=(30.0, 29.0), turn_rad=0.05)
    x, y, sigma = marker_pitch_px(picture(true, 4.0, noise=2.0))
    assert sigma < 0.01
    assert abs(x - 30.0) < 4 * sigma
    assert abs(y - 29.0) < 4 * sigma


@pytest.mark.thorough
def test_large_pictures_with_large_dots_are_no_harder() -> None:
    true = grid_points(5, 6, (200.0, 190.0), turn_rad=0.04, centre=(640.0, 480.0))
    image = draw_dots(1281, 963, true, 45.0) + np.random.default_rng(0).normal(0, 3, (963, 1281))
    found = find_markers(image)
    index, error = nearest(found.dots.uv_px, true)
    assert sorted(index) == list(range(30))
    z = error / found.dots.sigma_px
    assert np.abs(error).max() < 0.1
    assert np.sqrt((z**2).mean()) < 1.5
    assert np.median(found.dots.radius_px) == pytest.approx(45.0, abs=0.3)
