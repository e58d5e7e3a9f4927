# SPDX-License-Identifier: Apache-2.0
"""How close rendered tactile images come to captured ones, inside and around the contact.

Whole-image scores flatter: a bare background already agrees nearly everywhere. So every figure
is taken in the contact disc, in the square crop of half width 1.6 r around it, and over the whole
image, with the background alone as the baseline.

SSIM is that of Wang, Bovik, Sheikh and Simoncelli (IEEE TIP 13(4), 2004): Gaussian window with
sigma 1.5 px cut at 3.5 sigma (11x11 px), K1 = 0.01, K2 = 0.03, population moments, 255 levels,
mean over channels and over the pixels whose window lies inside the image; computed by kornia.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

CROP_RADII = 1.6
"""Half width of the crop in contact radii."""
MAX_LEVEL = 255.0
SSIM_WINDOW_PX = 11


@dataclass(frozen=True)
class ImageScore:
    """Agreement of one rendered image with its capture; levels of 255, RGB."""

    disc_l1: float
    """Mean absolute error inside the contact circle [levels]."""
    crop_l1: float
    """Mean absolute error in the crop of half width 1.6 r [levels]."""
    full_l1: float
    """Mean absolute error over the whole image [levels]."""
    crop_psnr_db: float
    """Peak signal-to-noise ratio in the crop [dB]."""
    crop_ssim: float
    """Structural similarity in the crop."""

    @property
    def psnr_db(self) -> float:
        """The figure that is quoted: that of the crop [dB]."""
        return self.crop_psnr_db


def score_image(
    rendered: np.ndarray,
    captured: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
) -> ImageScore:
    """Compare a rendered with a captured image, RGB levels, shape [height_px, width_px, 3]."""
    rendered = np.asarray(rendered, dtype=np.float64)
    captured = np.asarray(captured, dtype=np.float64)
    if rendered.shape != captured.shape:
        raise InputError(f"images differ in shape: {rendered.shape} and {captured.shape}")
    error = np.abs(rendered - captured)
    crop = crop_slices(circle, grid)
    disc = circle.distance_px(grid) <= circle.radius_px
    if not disc.any():
        raise InputError("no pixel of the contact counts")
    return ImageScore(
        disc_l1=float(error[disc].mean()),
        crop_l1=float(error[crop].mean()),
        full_l1=float(error.mean()),
        crop_psnr_db=psnr_db(rendered[crop], captured[crop]),
        crop_ssim=ssim(rendered[crop], captured[crop]),
    )


def crop_slices(circle: ContactCircle, grid: PixelGrid) -> tuple[slice, slice]:
    """Rows and columns of the crop around a contact, cut at the image's border."""
    half_u = CROP_RADII * circle.radius_px
    half_v = half_u * grid.mm_per_px_x / grid.mm_per_px_y
    rows = (round(circle.v_px - half_v), round(circle.v_px + half_v) + 1)
    columns = (round(circle.u_px - half_u), round(circle.u_px + half_u) + 1)
    return (
        slice(max(0, rows[0]), min(grid.height_px, rows[1])),
        slice(max(0, columns[0]), min(grid.width_px, columns[1])),
    )


def psnr_db(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio of two images [dB], infinite when they are equal."""
    mse = float(np.mean((np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2))
    return float("inf") if mse == 0 else float(10 * np.log10(MAX_LEVEL**2 / mse))


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Structural similarity of two images, shape [height, width, channels], both over 11 px: the
    mean over the pixels whose window lies inside the image."""
    a = np.asarray(a, dtype=np.float64)
    b = np.asarray(b, dtype=np.float64)
    size = SSIM_WINDOW_PX
    if min(a.shape[:2]) < size:
        raise InputError(f"SSIM needs images of at least {size}x{size} px, got {a.shape}")

    import kornia.metrics
    import torch

    first, second = (torch.from_numpy(image).permute(2, 0, 1)[None] for image in (a, b))
    score = kornia.metrics.ssim(first, second, size, max_val=MAX_LEVEL, padding="valid")
    return float(score.mean())
