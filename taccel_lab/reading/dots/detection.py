# SPDX-License-Identifier: Apache-2.0
"""All dots of a picture: found by their size, fitted one by one, compared with each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntFlag

import numpy as np
from scipy.spatial import KDTree

from taccel_lab.reading.dots import soft_ellipse as model
from taccel_lab.reading.dots.blobs import (
    MIN_CONTRAST,
    DotScale,
    bright_level,
    find_blobs,
    grey_levels,
    is_inside,
    reduced,
    response,
)
from taccel_lab.reading.dots.dot_fit import DotFit, fit_dots, joined
from taccel_lab.robust_fit import spread_about_median

_LARGE_PX = 10.0
"""Dots of twice this radius or more are found in a reduced picture: their rim is long enough."""
_WEAK = 0.3
"""A blob below this share of the usual contrast is not fitted."""
_FULL = 0.93
"""A dot of which less is seen is cut,"""
_HALF = 0.75
"""and one of which less was seen just before is so still."""
_NEIGHBOURS = 6
_SAME_SIZE = 0.01
"""Neighbouring dots are never known to be of one size better than by this part."""
_TOUCH = 1.1
"""Dots nearer than this, in sums of their radii, touch."""
_ODD_RADIUS = 1.6
_ODD_ROUND = 2.2
_ODD_CONTRAST = 0.35
_SAME_PLACE = 0.75
"""Fits nearer than this share of a radius found the same dot."""
_AREA = 1.45
"""A blob of at least this many usual areas can be two dots."""
_STRETCH = 1.4
"""And of at least this ratio of its axes, above the usual ratio."""


class DotFlag(IntFlag):
    """What is special about a dot; its centre is given nonetheless."""

    CUT = 1
    """Part of it lies outside the image: shape and size are taken from its neighbours."""
    MERGED = 2
    """It touched another dot and was split from it."""
    ODD = 4
    """Its size, shape or contrast is far from the others': perhaps no dot."""


@dataclass(frozen=True)
class Dots(DotFit):
    """The dots of a picture."""

    flags: np.ndarray
    """``DotFlag``s, uint8, shape [dot]."""
    scale: DotScale
    size_px: tuple[int, int]
    """Width and height of the image."""

    @property
    def whole(self) -> np.ndarray:
        """Dots that nothing is special about, bool, shape [dot]."""
        return self.flags == 0

    def flagged(self, flag: DotFlag) -> np.ndarray:
        """Dots that carry a flag, bool, shape [dot]."""
        return (self.flags & flag) != 0


def detect_dots(image: np.ndarray, scale: DotScale, like: Dots | None = None) -> Dots:
    """All dots of a known size and sign, strongest first.

    Args:
        image: RGB or grey levels, shape [height_px, width_px] or [.., 3].
        scale: Size, sign and contrast of the dots, see ``scale_candidates``.
        like: Dots of another picture of this gel, by which these are found in less time.
    """
    grey = grey_levels(image)
    factor = max(1, int(scale.radius_px / _LARGE_PX))
    if factor == 1:
        return _detect(grey, scale, like)
    small = replace(scale, sigma_px=scale.sigma_px / factor)
    like = None if like is None else _enlarged(like, 1 / factor, small, like.size_px)
    found = _detect(reduced(grey, factor), small, like)
    return _enlarged(found, factor, scale, (grey.shape[1], grey.shape[0]))


def _enlarged(dots: Dots, factor: float, scale: DotScale, size_px: tuple[int, int]) -> Dots:
    """Dots of a reduced picture in the pixels of the whole one."""
    parameters = dots.parameters.copy()
    parameters[:, :2] = (parameters[:, :2] + 0.5) * factor - 0.5
    parameters[:, model.SHAPE] /= factor
    parameters[:, model.LOG_BLUR] += np.log(factor)
    parameters[:, [model.SLOPE_U, model.SLOPE_V]] /= factor
    return replace(
        dots,
        parameters=parameters,
        covariance_px2=dots.covariance_px2 * factor**2,
        scale=scale,
        size_px=size_px,
    )


def _detect(grey: np.ndarray, scale: DotScale, like: Dots | None) -> Dots:
    start, places = _start(grey, scale)
    like = like if like is not None and like.count else None
    fit = fit_dots(grey, start) if like is None else _fit_alike(grey, start, places, like)
    quick = like is not None
    fit, merged = _split_touching(grey, fit, scale, quick)
    fit, keep = _without_twins(fit)
    merged = merged[keep]
    height, width = grey.shape
    cut = (fit.seen < _FULL) & ~_inside(fit, (width, height), -(fit.axes_px[:, 0] + 0.5))
    merged = merged | _touching(fit)
    partial = cut | merged
    if partial.any() and (~partial).sum() >= 3:
        fit = _refit_partial(grey, fit, partial, quick)
    flags = np.zeros(fit.count, dtype=np.uint8)
    flags[cut] |= np.uint8(DotFlag.CUT)
    flags[merged] |= np.uint8(DotFlag.MERGED)
    flags[_odd(fit, cut, scale.sign)] |= np.uint8(DotFlag.ODD)
    dots = Dots(**vars(fit), flags=flags, scale=scale, size_px=(width, height))
    # Dots with their centre in the picture, or at most half a radius outside; strongest first.
    kept = _inside(fit, dots.size_px, 0.5 * fit.radius_px) & (np.sign(fit.contrast) == scale.sign)
    kept = np.flatnonzero(kept & np.isfinite(fit.covariance_px2).all(axis=(1, 2)))
    return dots.select(kept[np.argsort(-np.abs(fit.contrast[kept]), kind="stable")])


def strong_blobs(image: np.ndarray, scale: DotScale) -> np.ndarray:
    """Whole pixels (u, v) of blobs that are strong enough for dots, shape [blob, 2]."""
    return _start(grey_levels(image), scale)[0][:, :2]


def _fit_alike(grey: np.ndarray, start: np.ndarray, places: np.ndarray, like: Dots) -> DotFit:
    """Dots at places [dot, 2], from the nearest whole ones of another picture but beside the
    border. What was cut off there is left as it starts, for ``_refit_partial``."""
    gap, nearest = map(np.asarray, KDTree(like.uv_px).query(places))
    cut = like.flagged(DotFlag.CUT) & (like.seen < _HALF)
    cut = cut[nearest] & (gap < like.radius_px[nearest])
    whole = like.whole[nearest] & is_inside(places, grey.shape, 2.0 * like.scale.radius_px)
    near = np.full((len(places), model.PARAMETERS), np.nan)
    if whole.any():
        known = like.parameters[like.whole]
        near[whole] = known[np.asarray(KDTree(known[:, :2]).query(places[whole])[1])]
        near[whole, :2] = places[whole]
    fit = fit_dots(grey, start[~cut], others=start[cut, :2], near=near[~cut])
    left = start[cut]
    left[:, model.CONTRAST] = like.contrast[nearest[cut]]
    unknown = np.tile(np.diag([np.inf, np.inf]), (len(left), 1, 1))
    none = np.zeros(len(left))
    return joined([fit, DotFit(left, unknown, none, none > 0)])


def _start(grey: np.ndarray, scale: DotScale) -> tuple[np.ndarray, np.ndarray]:
    """Round dots of one size at the blobs, shape [dot, 10], their levels left to the fit, and where
    parabolas through the blobs have their tops, [dot, 2]."""
    answer = response(grey, scale.sigma_px, bright_level(grey))
    uv, contrast = find_blobs(answer, scale.sigma_px, scale.sign, MIN_CONTRAST)
    strong = contrast > scale.threshold
    usual = float(np.median(contrast[strong])) if strong.any() else scale.threshold
    kept = contrast > min(scale.threshold, max(_WEAK * usual, 3.0 * MIN_CONTRAST))
    start = np.zeros((int(kept.sum()), model.PARAMETERS))
    start[:, :2] = uv[kept]
    start[:, model.SHAPE] = model.circle(scale.radius_px)
    start[:, model.LOG_BLUR] = np.log(max(0.2 * scale.radius_px, 0.6))
    return start, _tops(answer, uv[kept])


def _tops(answer: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Tops of the parabolas along each axis through extrema at whole pixels, [blob, 2]."""
    wide = np.pad(answer, 1, mode="edge")
    u, v = uv.T.astype(int) + 1
    middle = wide[v, u]
    found = []
    for before, after in ((wide[v, u - 1], wide[v, u + 1]), (wide[v - 1, u], wide[v + 1, u])):
        bend = before + after - 2 * middle
        found.append(0.5 * (before - after) / np.where(bend == 0, np.inf, bend))
    return uv + np.clip(np.stack(found, axis=1), -0.5, 0.5)


def _split_touching(
    grey: np.ndarray, fit: DotFit, scale: DotScale, quick: bool
) -> tuple[DotFit, np.ndarray]:
    """Fits with long double dots replaced by two dots each.

    Two dots of the usual size replace a long one only if both fits converge, are about as strong
    and lie about a diameter or less apart.

    Returns:
        All fits, and which of them come from a split, bool, shape [dot].
    """
    p = fit.parameters
    none = np.zeros(len(p), dtype=bool)
    if len(p) < 4:
        return fit, none
    axes = model.semi_axes(p)
    radius = model.mean_radius(p)
    usual = float(np.median(radius))
    stretch = axes[:, 0] / axes[:, 1]
    long = (radius**2 > _AREA * usual**2) & (stretch > _STRETCH * np.median(stretch))
    long &= radius < 2.2 * usual
    long &= np.sign(p[:, model.CONTRAST]) == scale.sign
    # Half of a pair that is mostly outside is seen too little.
    long &= _inside(fit, (grey.shape[1], grey.shape[0]), np.zeros(len(p)))
    if not long.any():
        return fit, none
    shape = np.median(p[~long], axis=0)
    half = (axes[long, 0] - usual)[:, None] * model.major_direction(p[long])
    start = np.repeat(p[long], 2, axis=0)
    start[0::2, :2] += half
    start[1::2, :2] -= half
    start[:, model.SHAPE] = shape[model.SHAPE]
    start[:, model.LOG_BLUR] = shape[model.LOG_BLUR]
    near = start if quick else None
    pair = fit_dots(grey, start, free_shape=False, others=p[~long, :2], near=near)
    good = np.ones(int(long.sum()), dtype=bool)
    contrast = pair.parameters[:, model.CONTRAST].reshape(-1, 2)
    gap = np.hypot(*(pair.uv_px[0::2] - pair.uv_px[1::2]).T)
    good &= pair.converged.reshape(-1, 2).all(axis=1)
    good &= np.abs(contrast).min(axis=1) > 0.5 * np.abs(contrast).max(axis=1)
    good &= np.sign(contrast).min(axis=1) == np.sign(contrast).max(axis=1)
    good &= (gap > 0.6 * usual) & (gap < 3.0 * usual)
    replaced = np.flatnonzero(long)[good]
    stay = np.setdiff1d(np.arange(len(p)), replaced)
    new = pair.select(np.flatnonzero(np.repeat(good, 2)))
    fit = joined([fit.select(stay), new])
    return fit, np.arange(fit.count) >= len(stay)


def _without_twins(fit: DotFit) -> tuple[DotFit, np.ndarray]:
    """Drop fits that fell onto a stronger one, or that lost their dot."""
    p = fit.parameters
    strength = np.abs(p[:, model.CONTRAST]) * np.where(fit.converged, 1.0, 0.5)
    radius = model.mean_radius(p)
    order = np.argsort(-strength)
    keep: list[int] = []
    for n in order:
        gap = np.hypot(*(p[keep, :2] - p[n, :2]).T) if keep else np.array([np.inf])
        if (gap > _SAME_PLACE * radius[n]).all():
            keep.append(int(n))
    chosen = np.array(keep, dtype=int)
    return fit.select(chosen), chosen


def _inside(fit: DotFit, size_px: tuple[int, int], slack_px: np.ndarray) -> np.ndarray:
    """Dots whose centre is at most ``slack_px`` [dot] outside of the picture, bool, shape [dot]."""
    u, v = fit.uv_px.T
    low = (u >= -slack_px) & (v >= -slack_px)
    return low & (u <= size_px[0] - 1 + slack_px) & (v <= size_px[1] - 1 + slack_px)


def _touching(fit: DotFit) -> np.ndarray:
    """Dots whose outline meets that of another one, bool, shape [dot]."""
    p = fit.parameters
    if len(p) < 2:
        return np.zeros(len(p), dtype=bool)
    radius = model.mean_radius(p)
    distance, nearest = map(np.asarray, KDTree(p[:, :2]).query(p[:, :2], k=2))
    usual = np.minimum(radius, np.median(radius))
    return distance[:, 1] < _TOUCH * (usual + usual[nearest[:, 1]])


def _refit_partial(grey: np.ndarray, fit: DotFit, cut: np.ndarray, quick: bool) -> DotFit:
    """Fit the place alone of dots that are partly seen, with the shape of the nearest whole ones.

    Where one edge alone is seen, an error of the size is an error of the place; the neighbours'
    spread in size enters the covariance by that.
    """
    p = fit.parameters
    whole = np.flatnonzero(~cut)
    start = p[cut].copy()
    radii = model.mean_radius(p)
    spread = np.empty(len(start))
    for n, dot in enumerate(start):
        gap = np.hypot(*(p[whole, :2] - dot[:2]).T)
        near = whole[np.argsort(gap)[:_NEIGHBOURS]]
        start[n, model.SHAPE] = np.median(p[near, model.SHAPE], axis=0)
        start[n, model.LOG_BLUR] = np.median(p[near, model.LOG_BLUR])
        off = spread_about_median(radii[near])
        spread[n] = max(off, _SAME_SIZE * np.median(radii[near]))
    near = start if quick else None
    again = fit_dots(grey, start, free_shape=False, others=p[~cut, :2], near=near)
    unknown = spread * np.minimum(1.0, 2.0 * (1.0 - again.seen))
    again.covariance_px2[:, [0, 1], [0, 1]] += unknown[:, None] ** 2
    partial = np.flatnonzero(cut)
    order = np.argsort(np.concatenate([whole, partial]))
    return joined([fit.select(whole), again]).select(order)


def _odd(dots: DotFit, cut: np.ndarray, sign: int) -> np.ndarray:
    """Dots unlike the nearest others in size, roundness or contrast."""
    odd = ~dots.converged | (np.sign(dots.contrast) != sign)
    if dots.count < 4:
        return odd
    radius, contrast = np.log(dots.radius_px), np.abs(dots.contrast)
    stretch = dots.axes_px[:, 0] / dots.axes_px[:, 1]
    gap = np.hypot(*(dots.uv_px[:, None] - dots.uv_px).transpose(2, 0, 1))
    gap[:, cut] += gap.max(axis=1, keepdims=True)
    near = np.argsort(gap, axis=1)[:, 1 : 2 * _NEIGHBOURS + 1]
    usual_radius, usual_stretch, usual_contrast = (
        np.median(values[near], axis=1) for values in (radius, stretch, contrast)
    )
    unlike = np.abs(radius - usual_radius) > np.log(_ODD_RADIUS)
    unlike |= stretch > _ODD_ROUND * np.maximum(usual_stretch, 1.0)
    return odd | (unlike & ~cut) | (contrast < _ODD_CONTRAST * usual_contrast)
