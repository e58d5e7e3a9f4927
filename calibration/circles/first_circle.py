# SPDX-License-Identifier: Apache-2.0
"""Where a contact is, roughly, without any guess: the start of every finer search."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from taccel_lab.calibration.circles.rim import RAY_COUNT, sample_rays

MIN_RADIUS_PX = 4.0
SPECK_SHARES = (1 / 75, 1 / 45)
"""Half width of specks, dust and edges of dots, as a part of the image's shorter side."""
GREY_SHARE = 0.1
"""Weight of a change that is the same all round, the only one on a grey sensor."""
SHADOW_LEVEL = 0.45
"""Colour change, as a part of the strongest, that shadows beside a contact stay below."""
SOUGHT_PX = 8
"""Discs are compared in pictures so coarse that their radius is that to twice that."""


def first_circle(change: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, float]:
    """Where a press is, roughly: centre (u, v) and radius [px].

    ``change`` is the colour change, shape [height, width, 3], pixels square; ``strength`` its size.
    Discs that stand out are looked for with and without specks; the one round which the colours
    turn most is taken, since a speck changes the same way on all its sides.
    """
    best = (-np.inf, np.zeros(2), 0.0)
    for share in (0.0, *SPECK_SHARES):
        center, radius = _standing_out(without_specks(strength, share) if share else strength)
        rays = np.nan_to_num(sample_rays(change, center, 1.3 * radius + 4))
        harmonics = np.abs(np.fft.fft(rays, axis=0)[:2] / RAY_COUNT) ** 2
        power = (harmonics[1] + GREY_SHARE * harmonics[0]).sum(axis=-1)
        score = float(power @ np.arange(len(power)))
        if score > best[0]:
            best = (score, center, radius)
    return best[1], best[2]


def _standing_out(strength: np.ndarray) -> tuple[np.ndarray, float]:
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
    center = (np.array([column, row]) + 0.5) * factor - 0.5
    return center, float(best * factor)


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


def gathered_share(strength: np.ndarray, center: np.ndarray, radius: float) -> float:
    """Share of what changes strongly in and through a circle that lies within two radii of it.

    Strong is half of what the circle's strongest tenth has; the areas that touch the circle count
    as a whole, so that an edge that goes on through the image gives a small share.
    """
    rows, columns = np.arange(strength.shape[0])[:, None], np.arange(strength.shape[1])[None, :]
    distance = np.hypot(columns - center[0], rows - center[1])
    disc = distance <= radius
    if not disc.any():
        return 0.0
    # The opening also cuts threads of noise between the contact and other strong changes.
    opened = without_specks(strength, SPECK_SHARES[0])
    strong = opened > 0.5 * np.percentile(opened[disc], 90)
    _, parts = cv2.connectedComponents(strong.astype(np.uint8))
    touching = np.unique(parts[disc & strong])
    touched = strong & np.isin(parts, touching)
    return float((touched & (distance <= 2 * radius)).sum() / max(touched.sum(), 1))


def turning_radius(change: np.ndarray, center: np.ndarray, radius: float) -> float:
    """Radius at which the part of the colour change that turns round with the angle is largest.

    That part, the first harmonic over the angle, follows the slope: it rises from the centre to the
    rim of a contact and falls behind it, whatever the light's drift and the gel's sinking do.
    """
    rays = np.nan_to_num(sample_rays(change, center, 1.3 * radius + 4))
    harmonic = np.fft.fft(rays, axis=0)[1]
    size = np.linalg.norm(np.abs(harmonic), axis=-1)
    return float(max(np.argmax(size), MIN_RADIUS_PX / 2))
