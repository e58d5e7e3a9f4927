# SPDX-License-Identifier: Apache-2.0
"""How thick the gel is, told by how it sinks around the balls.

A thin bonded gel is at rest two or three contact radii away and bulges up before; a thick one sinks
as far as one can see. Its colours say which: around a ball the change of colour goes once round
with the direction, as the slope does. How strongly it does so at which slope is known inside the
contact, where the gel has the ball's shape. So the slopes beside it are read off without any
assumption on the gel, and compared with those of bonded layers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.circles.ball_surface import LARGEST_RADII, ball_in_layer
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.bonded_layer import BondedLayer

RINGS = np.arange(0.1, 3.05, 0.1)
"""Edges of the rings, in contact radii."""
CENTRES = 0.5 * (RINGS[1:] + RINGS[:-1])
INSIDE, BESIDE = 0.9, 1.5
"""The gel has the ball's shape within the first; beside the rim, to the second, slopes are steeper
than the ball's colours tell, and blurred."""
WHOLE_RING = 0.97
LEAST_PRESSES, LEAST_RINGS = 4, 8
GAINS = (0.5, 2.0)
"""Bounds of the factor by which the slopes beside may be off alike, by light that differs there."""
RESAMPLED = 200
UNEXPLAINED = 0.25
"""Share of the slopes beside (root of squares) that the nearest layer may leave over: real sensors
leave 1 to 5 %, finite elements of balls pressed to half the thickness 2 to 17 %. What no layer
explains tells no thickness."""
THINNEST_MM, THICKEST_MM = 1.0, 16.0
"""Layers that are compared; a thicker one is a half-space within three contact radii."""
LAYERS, STEPS = 9, 200
"""Layers that are solved, and thicknesses between them."""
DEEPEST = 0.7
"""Largest share of a layer's thickness that a ball's cap may take."""
RADII = 3.2
"""Contact radii around the ball that are solved."""


@dataclass(frozen=True)
class BallImage:
    """One press under the background's light."""

    change: np.ndarray
    """RGB levels over the background, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    ball_mm: float


@dataclass(frozen=True)
class _Rings:
    """First harmonics of the change of colour around each press, of whole rings."""

    harmonic: np.ndarray
    """Cosine and sine of each channel [levels], shape [press, ring, 6]; NaN where not whole."""
    ball_slope: np.ndarray
    """Slope of the ball there, shape [press, ring]; NaN outside."""


@dataclass(frozen=True)
class RingEstimate:
    """What the images tell."""

    thickness_mm: np.ndarray
    """Nearest layers, by resampling the presses, half with slopes as they are and half with a
    common factor to them."""
    unexplained: float
    """Share of the slopes beside that the nearest layer leaves over."""


def estimate_by_rings(
    presses: Sequence[BallImage], grid: PixelGrid, usable: np.ndarray, layers: LayerFamily
) -> RingEstimate | None:
    """What presses on a flat gel tell of its thickness; None where too few rings around the
    contacts lie in the image, or no layer explains them.

    Args:
        presses: Ball presses.
        grid: Their pixel grid.
        usable: Pixels that may be used, bool, shape [height_px, width_px].
        layers: Layers under the typical contact.
    """
    rings = _measure(presses, grid, usable)
    seen = np.isfinite(rings.harmonic[..., 0]).sum(axis=0) >= LEAST_PRESSES
    beside = seen & (CENTRES > BESIDE)
    if beside.sum() < LEAST_RINGS or not (seen & np.isfinite(rings.ball_slope).any(axis=0)).any():
        return None
    slopes = layers.slopes(CENTRES)[:, beside]

    def nearest(drawn: _Rings, free: bool) -> tuple[float, float] | None:
        measured = _slopes(drawn)[beside]
        there = np.isfinite(measured)
        if there.sum() < LEAST_RINGS:
            return None
        k, left = _nearest(measured[there], slopes[:, there], free=free)
        return float(layers.thickness_mm[k]), left

    whole = [nearest(rings, free) for free in (False, True)]
    left = min((found[1] for found in whole if found is not None), default=np.inf)
    if left > UNEXPLAINED:
        return None
    rng, estimates = np.random.default_rng(0), []
    for _ in range(RESAMPLED):
        drawn = rng.integers(0, len(presses), len(presses))
        resampled = _Rings(rings.harmonic[drawn], rings.ball_slope[drawn])
        estimates += [found[0] for free in (False, True) if (found := nearest(resampled, free))]
    return RingEstimate(np.array(estimates), left) if len(estimates) >= RESAMPLED else None


def _measure(presses: Sequence[BallImage], grid: PixelGrid, usable: np.ndarray) -> _Rings:
    count = len(RINGS) - 1
    v, u = np.mgrid[: grid.height_px, : grid.width_px]
    harmonic = np.full((len(presses), count, 6), np.nan)
    slope = np.full((len(presses), count), np.nan)
    for i, press in enumerate(presses):
        circle = press.circle
        away = circle.distance_px(grid) / circle.radius_px
        angle = np.arctan2(
            (v - circle.v_px) * grid.mm_per_px_y, (u - circle.u_px) * grid.mm_per_px_x
        )
        ring_of = np.digitize(away, RINGS) - 1
        for k in range(count):
            ring = usable & (ring_of == k)
            area = np.pi * (RINGS[k + 1] ** 2 - RINGS[k] ** 2) * circle.radius_px**2
            if ring.sum() < WHOLE_RING * area * grid.mm_per_px_x / grid.mm_per_px_y:
                continue
            waves = np.stack([np.ones(ring.sum()), np.cos(angle[ring]), np.sin(angle[ring])], 1)
            harmonic[i, k] = np.linalg.lstsq(waves, press.change[ring], rcond=None)[0][1:].ravel()
            if RINGS[k + 1] <= INSIDE:
                r = away[ring] * circle.radius_px * grid.mm_per_px_x / press.ball_mm
                r = np.minimum(r, LARGEST_RADII)
                slope[i, k] = np.mean(r / np.sqrt(1 - r**2))
    return _Rings(harmonic, slope)


def _slopes(rings: _Rings) -> np.ndarray:
    """Slopes towards the balls, mean over presses, shape [ring]; NaN where steeper than the colours
    of the balls tell."""
    known = np.isfinite(rings.ball_slope) & np.isfinite(rings.harmonic[..., 0])
    if known.sum() < 3:
        return np.full(rings.ball_slope.shape[1], np.nan)
    along = rings.harmonic[known].T @ rings.ball_slope[known]
    strength = rings.harmonic @ (along / np.linalg.norm(along))
    x = rings.ball_slope[known]
    law = np.linalg.lstsq(np.stack([x, x**2, x**3], 1), strength[known], rcond=None)[0]
    steps = np.linspace(0.0, x.max(), 400)
    curve = steps * (law[0] + steps * (law[1] + steps * law[2]))
    top = int(np.argmax(curve)) + 1
    back = np.interp(np.abs(strength), curve[:top], steps[:top], right=np.nan)
    found = np.sign(strength) * back
    enough = np.isfinite(found).sum(axis=0) >= LEAST_PRESSES
    mean = np.nansum(found, axis=0) / np.maximum(np.isfinite(found).sum(axis=0), 1)
    return np.where(enough, mean, np.nan)


def _nearest(measured: np.ndarray, layers: np.ndarray, *, free: bool) -> tuple[int, float]:
    """Which of the layers, shape [layer, ring], is nearest by least squares, with a common factor
    where ``free``, and the share that it leaves over."""
    factor = np.ones(len(layers))
    if free:
        factor = np.clip(layers @ measured / np.sum(layers**2, axis=1), *GAINS)
    left = np.sum((measured - factor[:, None] * layers) ** 2, axis=1)
    k = int(np.argmin(left))
    return k, float(np.sqrt(left[k] / max(float(np.sum(measured**2)), 1e-12)))


@dataclass(frozen=True)
class LayerFamily:
    """Bonded layers of ``thickness_mm``, shape [layer], rising evenly in its logarithm, under one
    ball: how deep each is pressed until it touches in a circle, and how it slopes beside it."""

    thickness_mm: np.ndarray
    depth_mm: np.ndarray
    """Depth of the ball in each, shape [layer]."""
    away_radii: np.ndarray
    """Where slopes are known, contact radii from the ball's axis, shape [place]."""
    slope: np.ndarray
    """Slopes towards the ball there, shape [layer, place]."""

    @classmethod
    @lru_cache(maxsize=8)  # Blocks that are fitted to the same presses ask for the same layers.
    def under(cls, radius_mm: float, ball_mm: float, poisson_ratio: float) -> LayerFamily:
        """Layers that a ball touches in a circle of ``radius_mm``."""
        touched = min(radius_mm, LARGEST_RADII * ball_mm)
        cap_mm = ball_mm - np.sqrt(ball_mm**2 - touched**2)
        thinnest = min(max(THINNEST_MM, cap_mm / DEEPEST), 0.9 * THICKEST_MM)
        nodes = np.geomspace(thinnest, THICKEST_MM, LAYERS)
        # A pixel is a 24th of the radius: heights are solved on a 16th and smooth.
        radius_px = 24.0
        pitch = radius_mm / radius_px
        half = int(np.ceil(RADII * radius_px))
        grid = PixelGrid(2 * half + 1, 2 * half + 1, pitch, pitch)
        circle = ContactCircle(float(half), float(half), radius_px)
        depths, slopes = [], []
        for node in nodes:
            layer = BondedLayer(float(node), poisson_ratio)
            depth, rise = ball_in_layer(circle, ball_mm, grid, layer)
            depths.append(depth)
            slopes.append(np.gradient(rise[half, half:], pitch))
        thickness = np.geomspace(nodes[0], nodes[-1], STEPS)
        at = np.log(thickness)
        return cls(
            thickness,
            CubicSpline(np.log(nodes), depths)(at),
            np.arange(half + 1) / radius_px,
            CubicSpline(np.log(nodes), slopes)(at),
        )

    def slopes(self, away_radii: np.ndarray) -> np.ndarray:
        """Slopes at these places, shape [layer, place]."""
        return np.array([np.interp(away_radii, self.away_radii, row) for row in self.slope])
