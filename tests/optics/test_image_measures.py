# SPDX-License-Identifier: Apache-2.0
"""Measures of how near two images are, beside scikit-image, and the crop around a contact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.optics.image_measures import crop_slices, psnr_db, ssim


@given(
    height=st.integers(11, 40), width=st.integers(11, 40), seed=st.integers(0, 99),
    noise=st.floats(0.5, 60),
)  # fmt: skip
def test_ssim_and_psnr_are_scikit_images(height: int, width: int, seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    a = rng.uniform(0, 255, (height, width, 3))
    b = np.clip(a + rng.normal(0, noise, a.shape), 0, 255)
    reference = structural_similarity(
        a, b, channel_axis=2, data_range=255, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False,
    )  # fmt: skip
    assert ssim(a, b) == pytest.approx(reference, abs=1e-9)
    reference_db = peak_signal_noise_ratio(a, b, data_range=255)
    assert psnr_db(a, b) == pytest.approx(reference_db)
    assert ssim(a, a) == pytest.approx(1.0) and psnr_db(a, a) == float("inf")


def test_small_images_have_no_ssim() -> None:
    with pytest.raises(InputError, match="at least 11x11"):
        ssim(np.zeros((8, 20, 3)), np.zeros((8, 20, 3)))


def test_the_crop_is_square_in_millimetres() -> None:
    crop = crop_slices((100.0, 70.0), 20.0, PixelGrid(200, 150, 0.1, 0.1))
    assert [(s.start, s.stop) for s in crop] == [(38, 103), (68, 133)]
    rows, columns = crop_slices((100.0, 100.0), 20.0, PixelGrid(200, 200, 0.1, 0.05))
    assert (columns.stop - columns.start, rows.stop - rows.start) == (65, 129)
