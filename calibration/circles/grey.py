# SPDX-License-Identifier: Apache-2.0
"""The contact circle of a ball in a grey sensor's image, where darkness stands for depth.

Inside the contact the depth follows the ball, whose slope grows up to the rim and falls behind it.
So the grey drop is steepest at the rim, which is where it is taken. Two things blur that:
scattering in the gel, which moves the steepest place inwards, and the light beside the contact,
where grey gels brighten, which moves it outwards. Half the distance to where the slope has fallen
steepest is taken as the rim's uncertainty: the units of 9DTact's authors give 3 to 4 px. That
light is uneven around a contact, so the centre is that of the lines of equal grey further in.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.circles.color_change import (
    RAY_COUNT,
    circle_on_rays,
    sample_rays,
    square_pixels,
)
from taccel_lab.calibration.circles.labels import CutContactError, DetectedContact
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.robust_fit import spread_about_zero

SMOOTHING_PX = 2.0
PROFILE_SMOOTHING_PX = 1.0
"""Smoothing of the mean slope over all rays."""
MIN_DROP_LEVELS = 6.0
MIN_DROP_OVER_NOISE = 8.0
MIN_ROUND = 0.6
"""Smallest ratio of the axes of the dark patch at half its depth."""
MIN_RADIUS_PX = 6.0
ISOLINES = (0.4, 0.5, 0.6, 0.7)
"""Greys, as parts of the peak, whose lines give the centre."""
LABEL_SIGMA_PX, LABEL_SHARE = 2.0, 0.03
"""Standard deviation of a labelled radius: the least [px], and this share of it."""


def find_grey_contact(
    drop: np.ndarray,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    name: str = "image",
    label: ContactCircle | None = None,
) -> DetectedContact:
    """Contact circle from a map of grey drops [levels], shape [height_px, width_px].

    Where the image's border cuts the dark patch and the ``label``, the label is the contact. Raises
    InputError naming ``name`` when no round dark patch stands out, CutContactError where one
    touches the image's border.
    """
    values = np.asarray(drop, dtype=np.float32)
    if mask is not None:
        values = np.where(mask, values, np.float32(np.median(values[mask])))
    values = square_pixels(values, grid)
    ratio = grid.mm_per_px_y / grid.mm_per_px_x
    smooth = cv2.GaussianBlur(values, (0, 0), SMOOTHING_PX)
    noise = spread_about_zero(values - smooth) + 0.05
    peak = float(smooth.max())
    if peak < MIN_DROP_LEVELS or peak < MIN_DROP_OVER_NOISE * noise:
        raise InputError(
            f"{name}: no contact found; it darkens by {peak:.1f} levels of 255 at most over a "
            f"noise of {noise:.1f}; at least {MIN_DROP_LEVELS:g} levels and "
            f"{MIN_DROP_OVER_NOISE:g} times the noise are needed. Remove the frame, or is this a "
            "colour sensor (taccel-lab calibrate color, normals)?"
        )
    try:
        center, radius = _rough(smooth, peak, name)
    except CutContactError:
        if label is None or label.beyond_px(grid) <= 0:
            raise
        return DetectedContact(label, max(LABEL_SIGMA_PX, LABEL_SHARE * label.radius_px), peak)
    for _ in range(3):
        radius = _steepest_radius(smooth, center, radius)
        center = _isoline_center(smooth, center, radius, peak)
    # The mean over all rays is quiet enough; smoothing would move the steepest place inwards.
    steepest, fall = _rim_radii(values, center, radius)
    circle = ContactCircle(float(center[0]), float(center[1] / ratio), float(steepest))
    # Half the distance between the steepest drop and its steepest fall.
    return DetectedContact(circle, max(0.5 * (fall - steepest), 0.5), peak)


def _rough(smooth: np.ndarray, peak: float, name: str) -> tuple[np.ndarray, float]:
    """Centre and radius of the patch that is darker than half the peak."""
    labels, _ = ndimage.label(smooth > 0.5 * peak)  # type: ignore[misc]
    patch = labels == labels[np.unravel_index(int(np.argmax(smooth)), smooth.shape)]
    rows, columns = np.nonzero(patch)
    radius = float(np.sqrt(len(rows) / np.pi))
    axes = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(np.stack([columns, rows]))), 0.0))
    touches = rows.min() == 0 or columns.min() == 0
    touches |= rows.max() == smooth.shape[0] - 1 or columns.max() == smooth.shape[1] - 1
    if radius < MIN_RADIUS_PX or axes[0] < MIN_ROUND * axes[1] or touches:
        raise (CutContactError if touches else InputError)(
            f"{name}: no round contact found; the dark patch has a radius of {radius:.0f} px, axes "
            f"{axes[0]:.0f} and {axes[1]:.0f} px"
            + (" and touches the image's border" if touches else "")
            + f"; a ball leaves a round one of at least {MIN_RADIUS_PX:g} px inside the image. "
            "Remove the frame, or is this a colour sensor (taccel-lab calibrate color, normals)?"
        )
    return np.array([columns.mean(), rows.mean()]), radius


def _steepest_radius(smooth: np.ndarray, center: np.ndarray, radius: float) -> float:
    """Radius of the circle through the steepest drop along each ray, near the given one."""
    slope = -np.gradient(sample_rays(smooth, center, 1.8 * radius + 4), axis=1)
    slope = np.nan_to_num(slope, nan=-np.inf)
    slope[:, : int(0.4 * radius)] = -np.inf
    seen = np.isfinite(slope.max(axis=1))
    return circle_on_rays(np.argmax(slope, axis=1), seen, center, radius).radius


def _isoline_center(
    smooth: np.ndarray, center: np.ndarray, radius: float, peak: float
) -> np.ndarray:
    """Mean centre of the circles through the lines of equal grey inside the contact."""
    rays = np.nan_to_num(sample_rays(smooth, center, 1.1 * radius), nan=-np.inf)
    every = np.arange(RAY_COUNT)
    centers = []
    for share in ISOLINES:
        below = rays < share * peak
        reach = np.argmax(below, axis=1)
        seen = below.any(axis=1) & (reach > 0)
        if seen.sum() < RAY_COUNT // 2:
            continue
        before, after = rays[every, reach - 1], rays[every, reach]
        with np.errstate(invalid="ignore"):
            part = np.clip((before - share * peak) / np.maximum(before - after, 1e-6), 0, 1)
        crossing = np.where(seen, reach - 1 + part, 0.0)
        centers.append(circle_on_rays(crossing, seen, center, float(crossing[seen].mean())).center)
    return np.mean(centers, axis=0) if centers else center


def _rim_radii(values: np.ndarray, center: np.ndarray, radius: float) -> tuple[float, float]:
    """Radii of the steepest drop and of the steepest fall of its slope behind that [px]."""
    profile = np.nanmean(sample_rays(values, center, 2.0 * radius + 6), axis=0)
    profile = profile[np.isfinite(profile)]
    slope = -ndimage.gaussian_filter1d(np.gradient(profile), PROFILE_SMOOTHING_PX)
    first = int(0.5 * radius)
    steepest = first + int(np.argmax(slope[first:]))
    fall = -np.gradient(slope)
    last = min(len(fall), int(steepest + 0.6 * radius) + 2)
    return float(steepest), float(steepest + int(np.argmax(fall[steepest:last])))
