# SPDX-License-Identifier: Apache-2.0
"""Find the contact circle of a ball press in its image, without anybody clicking.

Where a ball presses, the colour changes with the slope of the gel. The slope grows from the
centre to the rim of the contact and falls off beyond it, so that along a ray from the centre the
colour runs to an extreme at the rim and then drops steeply. Two measurements follow:

1. the drop: the steepest colour gradient along each of many rays, and a robust circle through
   these points, which gives the centre;
2. the rise: the radius at which the colour change, averaged over all rays, is largest.

The lens blurs both: the largest change appears inside the rim, and the steepest drop outside it,
since the gel beyond the rim is still steep. The rim is taken midway between the two, and half the
distance between them is its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.capture.captures import CaptureSet, ContactCircle
from calibration.targets.circle_fit import CircleFit, fit_circle_ransac
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

RAY_COUNT = 180
SMOOTHING_PX = 2.0
MIN_CONTRAST_LEVELS = 12.0
"""Weakest colour change that counts as a contact, in levels of 255."""
MIN_CONTRAST_OVER_NOISE = 6.0
MIN_INLIER_FRACTION = 0.4
MIN_RADIUS_PX = 6.0
SHADOW_LEVEL = 0.45
"""Colour change, as a part of the strongest, that shadows beside a contact stay below."""


@dataclass(frozen=True)
class DetectedContact:
    """A contact found in an image, with what speaks for it."""

    circle: ContactCircle
    radius_sigma_px: float
    """Half the distance between the largest colour change and its steepest drop."""
    inlier_fraction: float
    """Rays whose steepest drop lies on the fitted circle."""
    edge_rms_px: float
    contrast_levels: float
    """99th percentile of the smoothed colour change [levels]."""


def detect_contact(
    image: np.ndarray,
    background: np.ndarray,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    name: str = "image",
) -> DetectedContact:
    """Contact circle of one ball press.

    ``image`` and ``background`` are RGB levels, shape [height_px, width_px, 3]. Raises InputError
    naming ``name`` when the image shows no contact or no round one.
    """
    change = _color_change(image, background, mask)
    strength = np.linalg.norm(change, axis=-1)
    contrast = float(np.percentile(strength, 99))
    noise = 1.4826 * float(np.median(np.abs(strength - np.median(strength)))) + 1e-6
    if contrast < MIN_CONTRAST_LEVELS or contrast < MIN_CONTRAST_OVER_NOISE * noise:
        raise InputError(
            f"{name}: no contact found; its strongest colour change is {contrast:.1f} levels of "
            f"255 over a noise of {noise:.1f}, at least {MIN_CONTRAST_LEVELS:g} levels and "
            f"{MIN_CONTRAST_OVER_NOISE:g} times the noise are needed. Remove the frame"
        )
    # Squared pixels: rows are resampled so that a round contact is a circle in the image.
    ratio = grid.mm_per_px_y / grid.mm_per_px_x
    if abs(ratio - 1) > 1e-6:
        size = (change.shape[1], max(2, round(change.shape[0] * ratio)))
        change = cv2.resize(change, size, interpolation=cv2.INTER_LINEAR)
        strength = np.linalg.norm(change, axis=-1)
    center, radius = _rough_circle(strength)
    fit = None
    for _ in range(4):
        fit = _fit_drop(change, center, radius)
        center, radius = fit.center, fit.radius
    assert fit is not None
    fraction = float(fit.inliers.mean())
    limit = min(change.shape[:2]) / 2
    if fraction < MIN_INLIER_FRACTION or not MIN_RADIUS_PX <= radius <= limit:
        raise InputError(
            f"{name}: no round contact found; {fraction:.0%} of the rays agree on a circle of "
            f"radius {radius:.1f} px, at least {MIN_INLIER_FRACTION:.0%} and {MIN_RADIUS_PX:g} to "
            f"{limit:g} px are needed. Remove the frame or give its circle"
        )
    rise = _rise_radius(change, center, radius)
    return DetectedContact(
        circle=ContactCircle(float(center[0]), float(center[1]) / ratio, (rise + radius) / 2),
        radius_sigma_px=abs(radius - rise) / 2,
        inlier_fraction=fraction,
        edge_rms_px=fit.rms,
        contrast_levels=contrast,
    )


def _color_change(image: np.ndarray, background: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Smoothed drift-free difference to the background, float32, shape [height, width, 3]."""
    change = image.astype(np.float32) - background.astype(np.float32)
    if mask is not None and not mask.all():
        # Masked pixels are filled from their neighbours before smoothing spreads them.
        change = _fill(change, mask)
    # Most of a frame is untouched, so its median is the light's drift.
    change -= np.median(change, axis=(0, 1), keepdims=True)
    return cv2.GaussianBlur(change, (0, 0), SMOOTHING_PX)


def _fill(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    weight = mask.astype(np.float32)
    filled = np.where(mask[..., None], values, 0.0).astype(np.float32)
    spread = cv2.GaussianBlur(filled, (0, 0), 4 * SMOOTHING_PX)
    total = cv2.GaussianBlur(weight, (0, 0), 4 * SMOOTHING_PX)[..., None]
    return np.where(mask[..., None], filled, spread / np.maximum(total, 1e-3)).astype(np.float32)


def _rough_circle(strength: np.ndarray) -> tuple[np.ndarray, float]:
    """Disc that stands out most from the ring of 1.4 times its radius, on a quarter-size image."""
    factor = max(1, min(strength.shape) // 120)
    size = (strength.shape[1] // factor, strength.shape[0] // factor)
    # Shadows beside the contact are weaker than its rim; cutting low values off removes them.
    strong = np.maximum(strength - SHADOW_LEVEL * np.percentile(strength, 99.5), 0.0)
    small = cv2.resize(strong, size, interpolation=cv2.INTER_AREA)
    best = (-np.inf, np.zeros(2), 0.0)
    for radius in np.geomspace(max(3.0, MIN_RADIUS_PX / factor), min(size) / 2.2, 24):
        reach = int(np.ceil(1.4 * radius))
        distance = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
        disc = distance <= radius
        ring = (distance > radius) & (distance <= 1.4 * radius)
        kernel = disc / disc.sum() - ring / ring.sum()
        # Outside the image the gel is taken as untouched, so a cut disc scores less.
        # The weight keeps a bright speck from winning over a whole contact.
        score = np.sqrt(radius) * cv2.filter2D(
            small, cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT
        )
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        if score[row, column] > best[0]:
            center = (np.array([column, row]) + 0.5) * factor - 0.5
            best = (float(score[row, column]), center, float(radius * factor))
    return best[1], best[2]


def _rays(change: np.ndarray, center: np.ndarray, reach_px: float) -> np.ndarray:
    """Colour change along rays from the centre at whole pixels, shape [RAY_COUNT, reach, 3].

    Samples outside the image are NaN.
    """
    angle = np.arange(RAY_COUNT)[:, None] * (2 * np.pi / RAY_COUNT)
    distance = np.arange(int(np.ceil(reach_px)) + 1)[None, :]
    x = (center[0] + distance * np.cos(angle)).astype(np.float32)
    y = (center[1] + distance * np.sin(angle)).astype(np.float32)
    rays = cv2.remap(change, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outside = (x < 0) | (y < 0) | (x > change.shape[1] - 1) | (y > change.shape[0] - 1)
    rays[outside] = np.nan
    return rays


def _speed(change: np.ndarray, center: np.ndarray, reach_px: float) -> np.ndarray:
    """Colour gradient along rays [levels/px], 0 outside the image, shape [RAY_COUNT, reach]."""
    rays = _rays(change, center, reach_px)
    return np.nan_to_num(np.linalg.norm(np.gradient(rays, axis=1), axis=-1), nan=0.0)


def _fit_drop(change: np.ndarray, center: np.ndarray, radius: float) -> CircleFit:
    """Circle through the point of each ray, near the given one, where the colour changes fastest"""
    speed = _speed(change, center, 1.3 * radius + 4)
    speed[:, : int(0.7 * radius)] = 0.0
    peak = np.argmax(speed, axis=1)
    angle = np.arange(RAY_COUNT) * (2 * np.pi / RAY_COUNT)
    reach = peak + _parabola_offset(speed, peak)
    points = center + reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    found = speed[np.arange(RAY_COUNT), peak] > 0
    if found.sum() < 3:
        found[:] = True
    fit = fit_circle_ransac(points[found], tolerance=max(2.0, 0.06 * radius))
    inliers = np.zeros(RAY_COUNT, dtype=bool)
    inliers[np.flatnonzero(found)[fit.inliers]] = True
    return CircleFit(fit.center, fit.radius, inliers, fit.rms)


def _rise_radius(change: np.ndarray, center: np.ndarray, drop_radius: float) -> float:
    """Radius of the largest mean colour change, at or inside the drop [px]."""
    rays = _rays(change, center, 1.3 * drop_radius + 4)
    with_data = ~np.isnan(rays[..., 0])
    strength = np.where(with_data, np.linalg.norm(np.nan_to_num(rays), axis=-1), 0.0)
    mean = strength.sum(axis=0) / np.maximum(with_data.sum(axis=0), 1)
    low, high = int(0.6 * drop_radius), int(np.ceil(drop_radius)) + 1
    peak = low + int(np.argmax(mean[low:high]))
    return float(peak + _parabola_offset(mean[None], np.array([peak]))[0])


def _parabola_offset(values: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Sub-sample position of each row's peak relative to its index, within half a sample."""
    rows = np.arange(len(values))
    middle = np.clip(peak, 1, values.shape[1] - 2)
    left, top, right = (values[rows, middle + k] for k in (-1, 0, 1))
    curvature = left - 2 * top + right
    offset = np.divide(0.5 * (left - right), curvature, out=np.zeros_like(top), where=curvature < 0)
    return np.where(middle == peak, np.clip(offset, -0.5, 0.5), 0.0)


@dataclass(frozen=True)
class LabelAgreement:
    """Detected against given contact circles, errors over the labelled presses [px]."""

    count: int
    center_median_px: float
    center_p90_px: float
    radius_median_px: float
    """Median of the absolute difference of the radii."""
    radius_p90_px: float
    radius_bias_px: float
    """Median of detected minus given radius."""


def resolve_contacts(captures: CaptureSet) -> list[DetectedContact]:
    """Detect the contact of every press; a press that shows none raises InputError."""
    return [
        detect_contact(
            press.image(),
            captures.background,
            captures.grid,
            mask=captures.mask,
            name=press.source,
        )
        for press in captures.presses
    ]


def compare_with_labels(
    captures: CaptureSet, detected: Sequence[DetectedContact]
) -> LabelAgreement | None:
    """How far the detected circles lie from the given ones; None when none are given."""
    center, radius = [], []
    for press, found in zip(captures.presses, detected, strict=True):
        if press.circle is not None:
            center.append(
                np.hypot(
                    found.circle.u_px - press.circle.u_px, found.circle.v_px - press.circle.v_px
                )
            )
            radius.append(found.circle.radius_px - press.circle.radius_px)
    if not center:
        return None
    size = np.abs(radius)
    return LabelAgreement(
        count=len(center),
        center_median_px=float(np.median(center)),
        center_p90_px=float(np.percentile(center, 90)),
        radius_median_px=float(np.median(size)),
        radius_p90_px=float(np.percentile(size, 90)),
        radius_bias_px=float(np.median(radius)),
    )
