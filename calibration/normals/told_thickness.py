# SPDX-License-Identifier: Apache-2.0
"""How thick the gel is, told by how it sinks around the balls.

A thin bonded gel is at rest two or three contact radii away and bulges up before; a thick one sinks
as far as one can see. Its colours say which: around a ball the change of colour goes once round
with the direction, as the slope does. How strongly it does so at which slope is known inside the
contact, where the gel has the ball's shape. So the slopes beside it are read off without any
assumption on the gel, and compared with those of bonded layers. That matters for absolute depths:
a circle says how deep the ball lies below its rim, the layer how far that rim has sunk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.normals.samples import InverseFrame, Scene, usable_pixels
from taccel_lab.calibration.normals.skirt import LARGEST_RADII, ball_in_layer
from taccel_lab.calibration.surfaces.bonded_layer import BondedLayer
from taccel_lab.geometry import PixelGrid

THINNEST_MM, THICKEST_MM = 1.0, 16.0
"""Layers that are compared; a thicker one is a half-space within three contact radii."""
LAYERS, STEPS = 9, 120
RINGS = np.arange(0.1, 3.05, 0.1)
"""Edges of the rings, in contact radii."""
INSIDE, BESIDE = 0.9, 1.5
"""The gel has the ball's shape within the first; beside the rim, to the second, slopes are steeper
than the ball's colours tell, and blurred."""
WHOLE_RING = 0.97
LEAST_PRESSES, LEAST_RINGS = 4, 8
GAINS = (0.5, 2.0)
"""By what the slopes beside may be off alike, by light that differs there."""
FLAT = float(np.cos(np.radians(5.0)))
"""Cosine of the tilt up to which a face at rest is as good as flat."""
RESAMPLED = 200
DEEPEST = 0.7
"""Of a layer's thickness, that a ball's cap may take."""


@dataclass(frozen=True)
class ToldThickness:
    """Thickness of the gel that the images tell, beside the one that is stated."""

    low_mm: float
    high_mm: float
    """Bounds of 95 %, by resampling the presses, with slopes as they are and with a common factor
    to them; ``THICKEST_MM`` stands for that and more."""
    stated_mm: float
    depth_low: float
    depth_high: float
    """Depths of these contacts in gels of the two, over those in the stated one."""


@dataclass(frozen=True)
class _Rings:
    """First harmonics of the change of colour around each press, of whole rings."""

    harmonic: np.ndarray
    """Cosine and sine of each channel [levels], shape [press, ring, 6]; NaN where not whole."""
    ball_slope: np.ndarray
    """Slope of the ball there, shape [press, ring]; NaN outside."""


def told_thickness(
    frames: Sequence[InverseFrame], scene: Scene, layer: BondedLayer
) -> ToldThickness | None:
    """What presses on a nearly flat gel tell of its thickness; None on a curved one, and where too
    few rings around the contacts lie in the image.

    Args:
        frames: Presses of one ball, under the background's light.
        scene: Their grid, background and ball.
        layer: The gel as stated; its Poisson's ratio is taken.
    """
    if scene.rest_normals is not None and scene.rest_normals[..., 2].min() < FLAT:
        return None
    rings = _measure(frames, scene)
    centres = 0.5 * (RINGS[1:] + RINGS[:-1])
    seen = np.isfinite(rings.harmonic[..., 0]).sum(axis=0) >= LEAST_PRESSES
    beside = seen & (centres > BESIDE)
    if beside.sum() < LEAST_RINGS or not (seen & np.isfinite(rings.ball_slope).any(axis=0)).any():
        return None
    typical = float(np.median([frame.circle.radius_px for frame in frames]))
    cap_mm = scene.ball_radius_mm - np.sqrt(
        scene.ball_radius_mm**2
        - min(typical * scene.grid.mm_per_px_x, LARGEST_RADII * scene.ball_radius_mm) ** 2
    )
    nodes = np.geomspace(max(THINNEST_MM, cap_mm / DEEPEST), THICKEST_MM, LAYERS)
    found = [_sinking(typical, scene, replace(layer, thickness_mm=t), centres) for t in nodes]
    thickness = np.geomspace(nodes[0], nodes[-1], STEPS)
    slopes = CubicSpline(np.log(nodes), [s for _, s in found])(np.log(thickness))[:, beside]
    depths = CubicSpline(np.log(nodes), [d for d, _ in found])

    told: dict[bool, list[float]] = {False: [], True: []}
    rng = np.random.default_rng(0)
    for _ in range(RESAMPLED):
        drawn = rng.integers(0, len(frames), len(frames))
        measured = _slopes(_Rings(rings.harmonic[drawn], rings.ball_slope[drawn]))
        there = np.isfinite(measured[beside])
        for free, best in told.items():
            if there.sum() >= LEAST_RINGS:
                k = _nearest(measured[beside][there], slopes[:, there], free=free)
                best.append(float(thickness[k]))
    if min(map(len, told.values())) < RESAMPLED // 2:
        return None
    low, high = (
        float(pick([np.quantile(best, q) for best in told.values()]))
        for pick, q in ((min, 0.025), (max, 0.975))
    )
    stated, _ = _sinking(typical, scene, layer, centres)
    over = depths(np.log([low, high])) / stated
    return ToldThickness(low, high, layer.thickness_mm, float(over[0]), float(over[1]))


def _measure(frames: Sequence[InverseFrame], scene: Scene) -> _Rings:
    grid, usable, count = scene.grid, usable_pixels(scene), len(RINGS) - 1
    v, u = np.mgrid[: grid.height_px, : grid.width_px]
    harmonic = np.full((len(frames), count, 6), np.nan)
    slope = np.full((len(frames), count), np.nan)
    for i, frame in enumerate(frames):
        circle = frame.circle
        away = circle.distance_px(grid) / circle.radius_px
        angle = np.arctan2(
            (v - circle.v_px) * grid.mm_per_px_y, (u - circle.u_px) * grid.mm_per_px_x
        )
        ring_of = np.digitize(away, RINGS) - 1
        change = frame.image - scene.background
        for k in range(count):
            ring = usable & (ring_of == k)
            area = np.pi * (RINGS[k + 1] ** 2 - RINGS[k] ** 2) * circle.radius_px**2
            if ring.sum() < WHOLE_RING * area * grid.mm_per_px_x / grid.mm_per_px_y:
                continue
            waves = np.stack([np.ones(ring.sum()), np.cos(angle[ring]), np.sin(angle[ring])], 1)
            harmonic[i, k] = np.linalg.lstsq(waves, change[ring], rcond=None)[0][1:].ravel()
            if RINGS[k + 1] <= INSIDE:
                r = away[ring] * circle.radius_px * grid.mm_per_px_x / scene.ball_radius_mm
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


def _nearest(measured: np.ndarray, layers: np.ndarray, *, free: bool) -> int:
    """Which of the layers, shape [layer, ring], is nearest by least squares, with a common factor
    where ``free``."""
    factor = np.ones(len(layers))
    if free:
        factor = np.clip(layers @ measured / np.sum(layers**2, axis=1), *GAINS)
    return int(np.argmin(np.sum((measured - factor[:, None] * layers) ** 2, axis=1)))


def _sinking(
    radius_px: float, scene: Scene, layer: BondedLayer, centres: np.ndarray
) -> tuple[float, np.ndarray]:
    """Depth [mm] of a contact of this radius and slopes towards it at ``centres`` contact radii."""
    pitch = scene.grid.mm_per_px_x
    half = int(np.ceil((centres[-1] + 0.2) * radius_px))
    grid = PixelGrid(2 * half + 1, 2 * half + 1, pitch, pitch)
    circle = ContactCircle(float(half), float(half), radius_px)
    depth, rise = ball_in_layer(circle, scene.ball_radius_mm, grid, layer)
    slope = np.gradient(rise[half, half:], pitch)
    return depth, np.interp(centres, np.arange(half + 1) / radius_px, slope)
