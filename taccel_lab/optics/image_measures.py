# SPDX-License-Identifier: Apache-2.0
"""Nearness of two images: peak signal-to-noise ratio, structural similarity, a contact's crop.

SSIM is that of Wang, Bovik, Sheikh and Simoncelli (IEEE TIP 13(4), 2004): Gaussian window with
sigma 1.5 px cut at 3.5 sigma (11x11 px), K1 = 0.01, K2 = 0.03, population moments, 255 levels,
mean over channels and over the pixels whose window lies inside the image; computed by kornia.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

CROP_RADII = 1.6
"""Half width of the crop in contact radii."""
MAX_LEVEL = 255.0
SSIM_WINDOW_PX = 11


def crop_slices(
    center_px: tuple[float, float], radius_px: float, grid: PixelGrid
) -> tuple[slice, slice]:
    """Rows and columns of the crop around a contact, whose centre is a column and a row, cut at
    the image's border."""
    u, v = center_px
    half_u = CROP_RADII * radius_px
    half_v = half_u * grid.mm_per_px_x / grid.mm_per_px_y
    rows = (round(v - half_v), round(v + half_v) + 1)
    columns = (round(u - half_u), round(u + half_u) + 1)
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
