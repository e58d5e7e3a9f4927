# SPDX-License-Identifier: Apache-2.0
"""Image scores against scikit-image and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.color.evaluate import crop_slices, psnr_db, score_image, ssim
from taccel_lab.calibration.result import mean_figures
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid


@given(
    height=st.integers(11, 40), width=st.integers(11, 40), seed=st.integers(0, 99),
    noise=st.floats(0.5, 60),
)  # fmt: skip
def test_ssim_and_psnr_agree_with_scikit_image(
    height: int, width: int, seed: int, noise: float
) -> None:
    rng = np.random.default_rng(seed)
    a = rng.uniform(0, 255, (height, width, 3))
    b = np.clip(a + rng.normal(0, noise, a.shape), 0, 255)
    reference = structural_similarity(
        a, b, channel_axis=2, data_range=255, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False,
    )  # fmt: skip
    assert ssim(a, b) == pytest.approx(reference, abs=1e-9)
    assert psnr_db(a, b) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=255))


def test_equal_images() -> None:
    image = np.random.default_rng(0).uniform(0, 255, (20, 20, 3))
    assert ssim(image, image) == pytest.approx(1.0)
    assert psnr_db(image, image) == float("inf")


def test_score_separates_disc_crop_and_image() -> None:
    grid = PixelGrid(200, 150, 0.1, 0.1)
    circle = ContactCircle(100.0, 70.0, 20.0)
    captured = np.full((150, 200, 3), 100.0)
    rendered = captured.copy()
    disc = circle.distance_px(grid) <= 20.0
    rendered[disc] += 6.0
    rendered[0, 0] += 30.0  # outside the crop
    score = score_image(rendered, captured, circle, grid)
    crop = crop_slices(circle, grid)
    assert (crop[0].start, crop[0].stop) == (38, 103)
    assert (crop[1].start, crop[1].stop) == (68, 133)
    assert score.disc_l1 == pytest.approx(6.0)
    assert score.crop_l1 == pytest.approx(6.0 * disc.sum() / 65**2)
    assert score.full_l1 == pytest.approx((6.0 * disc.sum() + 30.0) / disc.size)
    assert score.crop_psnr_db == pytest.approx(10 * np.log10(255**2 / (36.0 * disc.sum() / 65**2)))


def test_crop_of_oblong_pixels_is_square_in_millimetres() -> None:
    grid = PixelGrid(200, 200, 0.1, 0.05)
    rows, columns = crop_slices(ContactCircle(100.0, 100.0, 20.0), grid)
    assert columns.stop - columns.start == 65
    assert rows.stop - rows.start == 129


def test_mean_is_a_mean() -> None:
    grid = PixelGrid(60, 50, 0.1, 0.1)
    circle = ContactCircle(30.0, 25.0, 10.0)
    captured = np.full((50, 60, 3), 100.0)
    scores = [score_image(captured + error, captured, circle, grid) for error in (1.0, 5.0, 2.0)]
    assert mean_figures(scores)["disc_l1"] == pytest.approx(8 / 3)


def test_shapes_are_checked() -> None:
    grid = PixelGrid(60, 50, 0.1, 0.1)
    with pytest.raises(InputError, match="differ in shape"):
        score_image(np.zeros((50, 60, 3)), np.zeros((50, 61, 3)), ContactCircle(30, 25, 10), grid)
    with pytest.raises(InputError, match="at least 11x11"):
        ssim(np.zeros((8, 20, 3)), np.zeros((8, 20, 3)))
