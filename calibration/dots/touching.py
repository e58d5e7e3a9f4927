# SPDX-License-Identifier: Apache-2.0
"""Dots that touch: one long blob of twice the usual area is fitted again as two dots."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.dots import soft_ellipse as model
from taccel_lab.calibration.dots.blobs import DotScale
from taccel_lab.calibration.dots.dot_fit import DotFit, fit_dots

_AREA = 1.45
"""A blob of at least this many usual areas can be two dots."""
_STRETCH = 1.4
"""And of at least this ratio of its axes, above the usual ratio."""


def split_merged(grey: np.ndarray, fit: DotFit, scale: DotScale) -> tuple[DotFit, np.ndarray]:
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
    if not long.any():
        return fit, none
    shape = np.median(p[~long], axis=0)
    half = (axes[long, 0] - usual)[:, None] * model.major_direction(p[long])
    start = np.repeat(p[long], 2, axis=0)
    start[0::2, :2] += half
    start[1::2, :2] -= half
    start[:, model.SHAPE] = shape[model.SHAPE]
    start[:, model.LOG_BLUR] = shape[model.LOG_BLUR]
    pair = fit_dots(grey, start, free_shape=False, others=p[~long, :2])
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
    kept = fit.select(stay)
    joined = DotFit(
        *(
            np.concatenate([getattr(kept, name), getattr(new, name)])
            for name in DotFit.__dataclass_fields__
        )
    )
    flag = np.concatenate([np.zeros(len(stay), dtype=bool), np.ones(len(new.seen), dtype=bool)])
    return joined, flag
