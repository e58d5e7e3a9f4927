# SPDX-License-Identifier: Apache-2.0
"""Where a contact is, roughly, without any guess: the start of every finer search.

Rays from a centre, and circles through what is seen along them, such as the rim, come first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from scipy.optimize import least_squares

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.circles.color_change import ColorChange

RAY_COUNT = 180
MIN_RADIUS_PX = 4.0
SPECK_SHARES = (1 / 75, 1 / 45)
"""Half width of specks, dust and edges of dots, as a part of the image's shorter side."""
GREY_SHARE = 0.1
"""Weight of a change that is the same all round, the only one on a grey sensor."""
SHADOW_LEVEL = 0.45
"""Colour change, as a part of the strongest, that shadows beside a contact stay below."""
SOUGHT_PX = 8
"""Discs are compared in pictures so coarse that their radius is that to twice that."""


@dataclass(frozen=True)
class CircleFit:
    """A circle and how well points agree with it."""

    center: np.ndarray
    """(x, y), shape [2]."""
    radius: float
    inliers: np.ndarray
    """Points within the tolerance, bool, shape [point_count]."""


def sample_rays(image: np.ndarray, center: np.ndarray, reach_px: float) -> np.ndarray:
    """Values of an image [rows, columns(, channels)] along rays from ``center``, a pixel apart.

    Shape [180, reach + 1(, channels)]; NaN outside the image.
    """
    angle = np.arange(RAY_COUNT)[:, None] * (2 * np.pi / RAY_COUNT)
    distance = np.arange(int(np.ceil(reach_px)) + 1)[None, :]
    x = (center[0] + distance * np.cos(angle)).astype(np.float32)
    y = (center[1] + distance * np.sin(angle)).astype(np.float32)
    rays = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outside = (x < 0) | (y < 0) | (x > image.shape[1] - 1) | (y > image.shape[0] - 1)
    rays[outside] = np.nan
    return rays


def fit_circle(
    points: np.ndarray, center: np.ndarray, radius: float, tolerance: float
) -> CircleFit:
    """Circle through points [n, 2], from one nearby; points beyond ``tolerance`` have no say.

    Distances from the circle count after Cauchy first, which finds the points that agree, and those
    alone by least squares then.
    """

    def off(circle: np.ndarray) -> np.ndarray:
        return np.hypot(*(points - circle[:2]).T) - circle[2]

    start = np.array([*center, radius])
    found = least_squares(off, start, loss="cauchy", f_scale=tolerance).x
    inliers = np.abs(off(found)) < tolerance
    for _ in range(2):
        kept = inliers if inliers.sum() >= 3 else np.ones(len(points), dtype=bool)
        found = least_squares(lambda circle, kept=kept: off(circle)[kept], found).x
        inliers = np.abs(off(found)) < tolerance
    return CircleFit(found[:2], float(found[2]), inliers)


def circle_on_rays(
    reach_px: np.ndarray, seen: np.ndarray, center: np.ndarray, radius: float
) -> CircleFit:
    """Circle through a place on each ray from ``center``; inliers are rays.

    ``reach_px`` is how far out the place lies, shape [180]; rays that are not ``seen`` (bool,
    likewise) have none.
    """
    angle = np.arange(RAY_COUNT) * (2 * np.pi / RAY_COUNT)
    points = center + reach_px[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if seen.sum() < 3:
        seen = np.ones(RAY_COUNT, dtype=bool)
    fit = fit_circle(points[seen], center, radius, tolerance=max(2.0, 0.06 * radius))
    inliers = np.zeros(RAY_COUNT, dtype=bool)
    inliers[np.flatnonzero(seen)[fit.inliers]] = True
    return CircleFit(fit.center, fit.radius, inliers)


def fit_rim(change: np.ndarray, center: np.ndarray, radius: float) -> CircleFit:
    """Circle through the point of each ray where the colour changes fastest, near the given one.

    The lens blurs the rim, so that this circle is a little wider than the contact.
    """
    rays = sample_rays(change, center, 1.4 * radius + 4)
    speed = np.nan_to_num(np.linalg.norm(np.gradient(rays, axis=1), axis=-1), nan=0.0)
    speed[:, : int(0.75 * radius)] = 0.0
    peak = np.argmax(speed, axis=1)
    reach = peak + _parabola_offset(speed, peak)
    return circle_on_rays(reach, speed[np.arange(RAY_COUNT), peak] > 0, center, radius)


def _parabola_offset(values: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Sub-sample position of each row's peak relative to its index, within half a sample."""
    rows = np.arange(len(values))
    middle = np.clip(peak, 1, values.shape[1] - 2)
    left, top, right = (values[rows, middle + k] for k in (-1, 0, 1))
    curvature = left - 2 * top + right
    offset = np.divide(0.5 * (left - right), curvature, out=np.zeros_like(top), where=curvature < 0)
    return np.where(middle == peak, np.clip(offset, -0.5, 0.5), 0.0)


def first_circle(change: ColorChange) -> ContactCircle:
    """Where a press is, roughly, in pixels of its colour change.

    Discs that stand out are looked for with and without specks; the one round which the colours
    turn most is taken, since a speck changes the same way on all its sides.
    """
    strength = change.strength()
    best, most = ContactCircle(0.0, 0.0, 0.0), -np.inf
    for share in (0.0, *SPECK_SHARES):
        circle = _standing_out(without_specks(strength, share) if share else strength)
        harmonics = np.abs(_harmonics(change, circle)[:2] / RAY_COUNT) ** 2
        power = (harmonics[1] + GREY_SHARE * harmonics[0]).sum(axis=-1)
        score = float(power @ np.arange(len(power)))
        if score > most:
            best, most = circle, score
    return best


def _harmonics(change: ColorChange, circle: ContactCircle) -> np.ndarray:
    """Fourier transform over the angle of the change along rays, shape [180, reach, 3]."""
    center = np.array([circle.u_px, circle.v_px])
    rays = sample_rays(change.change, center, 1.3 * circle.radius_px + 4)
    return np.fft.fft(np.nan_to_num(rays), axis=0)


def _standing_out(strength: np.ndarray) -> ContactCircle:
    """Disc that stands out most from the ring of 1.4 times its radius."""
    factor = max(1, min(strength.shape) // 120)
    size = (strength.shape[1] // factor, strength.shape[0] // factor)
    # Shadows beside the contact are weaker than its rim; cutting low values off removes them.
    highest = max(np.percentile(strength, 99.5), 0.6 * float(strength.max()))
    strong = np.maximum(strength - SHADOW_LEVEL * highest, 0.0)
    small = cv2.resize(strong.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    # Coarser pictures say which disc stands out most, this one where it is.
    radii = np.geomspace(max(2.0, MIN_RADIUS_PX / factor), min(size) / 2.2, 24)
    best = radii[np.argmax([_scores(small, radius, SOUGHT_PX).max() for radius in radii])]
    scores = _scores(small, best)
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    u_px, v_px = (np.array([column, row]) + 0.5) * factor - 0.5
    return ContactCircle(float(u_px), float(v_px), float(best * factor))


def _scores(picture: np.ndarray, radius: float, fewest_px: float = np.inf) -> np.ndarray:
    """How far a disc of this radius stands out at each pixel, or where its radius is at least twice
    ``fewest_px``, at those of a picture that much coarser.

    The weight keeps a bright speck from winning over a whole contact.
    """
    coarser = max(1, int(radius / fewest_px))
    if coarser > 1:
        size = (picture.shape[1] // coarser, picture.shape[0] // coarser)
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    # Outside the image the gel is taken as untouched, so a cut disc scores less.
    kernel = _ringed_disc(radius / coarser)
    return np.sqrt(radius) * cv2.filter2D(
        picture, cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT
    )


@lru_cache(maxsize=256)
def _ringed_disc(radius: float) -> np.ndarray:
    """Kernel of the mean over a disc less that over the ring of 1.4 times its radius."""
    reach = int(np.ceil(1.4 * radius))
    distance = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    disc = distance <= radius
    ring = (distance > radius) & (distance <= 1.4 * radius)
    return disc / disc.sum() - ring / ring.sum()


def without_specks(strength: np.ndarray, share: float) -> np.ndarray:
    """Grey opening that wipes out what is smaller, in half its width, than a part of the image."""
    size = 2 * max(1, round(min(strength.shape) * share)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(np.asarray(strength, np.float32), cv2.MORPH_OPEN, kernel)


def gathered_share(change: ColorChange, circle: ContactCircle) -> float:
    """Share of what changes strongly in and through a circle that lies within two radii of it.

    Strong is half of what the circle's strongest tenth has; the areas that touch the circle count
    as a whole, so that an edge that goes on through the image gives a small share.
    """
    distance = circle.distance_px(change.grid)
    disc = distance <= circle.radius_px
    if not disc.any():
        return 0.0
    # The opening also cuts threads of noise between the contact and other strong changes.
    opened = without_specks(change.strength(), SPECK_SHARES[0])
    strong = opened > 0.5 * np.percentile(opened[disc], 90)
    _, parts = cv2.connectedComponents(strong.astype(np.uint8))
    touching = np.unique(parts[disc & strong])
    touched = strong & np.isin(parts, touching)
    return float((touched & (distance <= 2 * circle.radius_px)).sum() / max(touched.sum(), 1))


def turning_radius(change: ColorChange, circle: ContactCircle) -> float:
    """Radius at which the part of the colour change that turns round with the angle is largest.

    That part, the first harmonic over the angle, follows the slope: it rises from the centre to the
    rim of a contact and falls behind it, whatever the light's drift and the gel's sinking do.
    """
    size = np.linalg.norm(np.abs(_harmonics(change, circle)[1]), axis=-1)
    return float(max(np.argmax(size), MIN_RADIUS_PX / 2))
