# SPDX-License-Identifier: Apache-2.0
"""The model's picture against a real one: backgrounds, and ball presses inside their contact.

A real sensor's exposure, white balance and offset are not known, so that backgrounds are compared
after a gain and an offset per channel, and presses by the colour that each octant of the ball turns
to.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

OCTANTS = 8
_RING = (0.3, 0.9)
"""Part of the contact radius in which octants are compared: the middle is flat, the edge
uncertain."""


class BackgroundMatch(NamedTuple):
    """How like two untouched images are."""

    correlation: tuple[float, ...]
    """Of the low-pass images by channel."""
    psnr_db: float
    """Of the low-pass model after a gain and an offset per channel."""
    flat_psnr_db: float
    """The same for one colour in place of the model: what gain and offset reach by themselves."""


class PressMatch(NamedTuple):
    """How like two ball presses are inside the contact."""

    correlation: tuple[float, ...]
    """Of the change against the background by channel, inside the contact circle."""
    octant_cosine: tuple[float, ...]
    """Cosine between the colour changes of real and model, octant by octant from +x towards +y."""
    contrast: float
    """Root mean square of the model's change over the real one's, inside the contact circle."""

    @property
    def mean_cosine(self) -> float:
        return float(np.mean(self.octant_cosine))


def compare_backgrounds(
    real_rgb: np.ndarray, model_rgb: np.ndarray, mask: np.ndarray, *, blur_px: float
) -> BackgroundMatch:
    """Compare two untouched images [H, W, 3] on the pixels of ``mask``, after a low-pass filter of
    this standard deviation: dust and the coating's texture are not modelled."""
    real, model = (_low_pass(rgb, mask, blur_px)[mask] for rgb in (real_rgb, model_rgb))
    fitted = np.stack(
        [np.polyval(np.polyfit(*c, 1), c[0]) for c in zip(model.T, real.T, strict=True)], axis=1
    )
    flat = _psnr_db(real.mean(axis=0) - real)
    return BackgroundMatch(_correlations(model, real), _psnr_db(fitted - real), flat)


def compare_press(
    real: tuple[np.ndarray, np.ndarray],
    model: tuple[np.ndarray, np.ndarray],
    center_px: tuple[float, float],
    radius_px: float,
) -> PressMatch:
    """Compare two ball presses, each background and press, at one contact circle (u, v)."""
    v, u = np.indices(real[0].shape[:2])
    du, dv = u - center_px[0], v - center_px[1]
    distance = np.hypot(du, dv) / radius_px
    octant = np.floor(np.arctan2(dv, du) / (2 * math.pi / OCTANTS) + 0.5).astype(int) % OCTANTS
    of_real, of_model = (after.astype(np.float64) - before for before, after in (real, model))
    inside = distance < _RING[1]
    cosines = []
    for k in range(OCTANTS):
        here = inside & (distance > _RING[0]) & (octant == k)
        a, b = of_real[here].mean(axis=0), of_model[here].mean(axis=0)
        cosines.append(float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12)))
    a, b = of_real[inside], of_model[inside]
    contrast = float(np.linalg.norm(b) / max(np.linalg.norm(a), 1e-12))
    return PressMatch(_correlations(b, a), tuple(cosines), contrast)


def pressed_top(
    top_mm: Callable[[np.ndarray], np.ndarray],
    center_mm: tuple[float, float],
    contact_radius_mm: float,
    ball_radius_mm: float,
    *,
    thin: bool = False,
) -> Callable[[np.ndarray], np.ndarray]:
    """Contact face under a ball: the ball within the contact, an elastic half-space around it.

    Outside of the contact radius a the face has sunk by ``a^2 / (pi R) ((2 - r^2/a^2) asin(a/r) +
    sqrt(r^2/a^2 - 1))`` (K. L. Johnson, "Contact Mechanics", 1985, eq. 3.42). A gel that is thin
    against the contact (``thin``) does not sink around it (K. L. Johnson, section 5.8); its pile-up
    is left out. ``top_mm``: the untouched face, [..., 2] -> [...].
    """
    a, ball = contact_radius_mm, ball_radius_mm
    edge = 0.0 if thin else a * a / (2 * ball)
    drop_at_edge = ball - math.sqrt(ball * ball - a * a)

    def sunk_mm(xy_mm: np.ndarray) -> np.ndarray:
        ratio = np.linalg.norm(np.asarray(xy_mm) - np.array(center_mm), axis=-1) / a
        inner = np.minimum(ratio, 1.0) * a
        ball_part = edge + drop_at_edge - (ball - np.sqrt(ball * ball - inner * inner))
        outer = np.maximum(ratio, 1.0)
        tail = (
            (a * a / (math.pi * ball))
            * ((2 - outer**2) * np.arcsin(1 / outer) + np.sqrt(outer**2 - 1))
            * (not thin)
        )  # fmt: skip
        return top_mm(xy_mm) - np.where(ratio <= 1, ball_part, tail)

    return sunk_mm


def _low_pass(image: np.ndarray, mask: np.ndarray, blur_px: float) -> np.ndarray:
    """Gaussian low-pass that takes nothing from outside the mask."""
    weight = gaussian_filter(mask.astype(np.float64), blur_px, mode="nearest")
    values = image.astype(np.float64) * mask[..., None]
    blurred = gaussian_filter(values, (blur_px, blur_px, 0), mode="nearest")
    return blurred / np.maximum(weight, 1e-6)[..., None]


def _correlations(model: np.ndarray, real: np.ndarray) -> tuple[float, ...]:
    """Pearson's correlation by channel; 0 where one of the two is constant."""
    a, b = model - model.mean(axis=0), real - real.mean(axis=0)
    norm = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    return tuple(np.divide((a * b).sum(axis=0), norm, out=np.zeros(3), where=norm > 0).tolist())


def _psnr_db(error: np.ndarray) -> float:
    return float(20 * math.log10(255.0 / max(math.sqrt(float(np.mean(error**2))), 1e-6)))
