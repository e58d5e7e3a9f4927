# SPDX-License-Identifier: Apache-2.0
"""Centres of dots to a fraction of a pixel: least squares of ``dot_model`` on the dots' pixels.

All dots of a picture are fitted at once (Levenberg and Marquardt). Pixels far off the model, such
as glints and scratches, lose weight (Huber's); pixels that are nearer to another dot have none.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.markers import dot_model as model

_SMOOTH_PX = 0.6
"""Blur before the fit: a step between pixels is no soft edge and would pull centres by 0.01 px."""
_CHUNK = 400_000
"""Dots times pixels that are fitted in one go."""
_STEPS = 25
_MOVED_PX = 1e-4
_SETTLED_PX = 0.02
"""A centre that still moves by more in the last step is not found."""
_HUBER = 2.0
_OFF = 0.04
"""Share of a dot's step in level by which pixels may always be off: the model is no better."""
_LEVEL_SIGMA = 0.6
"""And standard deviation in levels that is always granted: rounding, and a little noise."""
_PRIOR_BLUR = 1.0
"""Standard deviation of the logarithm of the blur about its guess."""
_PRIOR_ROUND = 0.5
"""Standard deviation of the relative shape about its guess."""
_MIN_BLUR_PX, _MAX_BLUR = 0.25, 1.5
"""Blur's least value [px], and its largest as a share of the radius."""


@dataclass(frozen=True)
class DotFit:
    """Fitted dots."""

    parameters: np.ndarray
    """``dot_model``'s, centres in the image, shape [dot, 10]."""
    covariance: np.ndarray
    """Of the centres [px^2], shape [dot, 2, 2]; infinite where the fit has no hold."""
    residual: np.ndarray
    """Weighted standard deviation of the pixels about the model [levels], shape [dot]."""
    seen: np.ndarray
    """Share of the ellipse's area that lies in the image and is nearest to this dot, [dot]."""
    converged: np.ndarray
    """Bool, shape [dot]."""

    @property
    def uv_px(self) -> np.ndarray:
        """Centres (u, v) [px], shape [dot, 2]."""
        return self.parameters[:, :2]

    def select(self, which: np.ndarray) -> DotFit:
        """Some of the dots."""
        return DotFit(
            self.parameters[which],
            self.covariance[which],
            self.residual[which],
            self.seen[which],
            self.converged[which],
        )


def fit_dots(
    grey: np.ndarray,
    start: np.ndarray,
    *,
    free_shape: bool = True,
    others: np.ndarray | None = None,
) -> DotFit:
    """Fit dots from a guess.

    Args:
        grey: Levels, shape [height_px, width_px].
        start: ``dot_model`` parameters with centres in the image, shape [dot, 10]; level,
            contrast and slopes are read from the picture.
        free_shape: Fit ellipse and blur too; otherwise they stay as in ``start``.
        others: Further centres (u, v) whose pixels are left out, shape [other, 2].
    """
    count = len(start)
    parts = []
    grey = cv2.GaussianBlur(grey, (0, 0), _SMOOTH_PX, borderType=cv2.BORDER_REPLICATE)
    centres = start[:, :2] if others is None else np.concatenate([start[:, :2], others])
    # Dots much larger than the rest would make all windows large.
    radii = model.mean_radius(start)
    order = np.argsort(radii)
    first = 0
    while first < count:
        last = first + 1
        while last < count and (last + 1 - first) * _pixels(float(radii[order[last]])) <= _CHUNK:
            last += 1
        parts.append(_fit_chunk(grey, start, order[first:last], centres, free_shape))
        first = last
    if not parts:
        return DotFit(
            np.empty((0, model.PARAMETERS)),
            np.empty((0, 2, 2)),
            np.empty(0),
            np.empty(0),
            np.empty(0, dtype=bool),
        )
    back = np.empty(count, dtype=int)
    back[order] = np.arange(count)
    joined = DotFit(*(np.concatenate(items) for items in zip(*parts, strict=True)))
    return joined.select(back)


def window_half(radius_px: float) -> int:
    """Half width of the square of pixels that a dot is fitted to."""
    return int(np.ceil(1.7 * radius_px + 2.5))


def _pixels(radius_px: float) -> int:
    return (2 * window_half(radius_px) + 1) ** 2


def _fit_chunk(
    grey: np.ndarray, start: np.ndarray, which: np.ndarray, centres: np.ndarray, free_shape: bool
) -> tuple[np.ndarray, ...]:
    p = start[which].astype(np.float64)
    half = window_half(float(model.mean_radius(p).max()))
    origin = np.rint(p[:, :2])
    p[:, :2] -= origin
    span = np.arange(-half, half + 1)
    uv = np.stack(np.meshgrid(span, span), axis=-1).reshape(-1, 2).astype(np.float64)
    levels, inside = _pixels_of(grey, origin, span)
    own = inside & _nearest_to_own(uv, p, origin, which, centres)
    _read_levels(p, uv, levels, own)
    guess = p.copy()

    free = np.ones(model.PARAMETERS, dtype=bool)
    free[[model.S11, model.S12, model.S22, model.LOG_BLUR]] = free_shape
    scale = np.maximum(_LEVEL_SIGMA, _OFF * np.abs(p[:, model.CONTRAST] * p[:, model.LEVEL]))
    damping = np.full(len(p), 1e-3)
    value, jacobian = model.evaluate(p, uv)
    weight = _weights(levels - value, own, scale)
    cost = _cost(levels - value, weight, p, guess, scale, free)
    done = np.zeros(len(p), dtype=bool)
    last_move = np.full(len(p), np.inf)
    for _ in range(_STEPS):
        weight = _weights(levels - value, own, scale)
        cost = _cost(levels - value, weight, p, guess, scale, free)
        normal, gradient = _normal_equations(
            levels - value, weight, jacobian, p, guess, scale, free
        )
        diagonal = np.einsum("nii->ni", normal)
        damped = normal.copy()
        np.einsum("nii->ni", damped)[:] += damping[:, None] * diagonal + 1e-12
        step = np.linalg.solve(damped, gradient[..., None])[..., 0]
        step[done] = 0.0
        trial = _bounded(p + step, guess)
        trial_value, trial_jacobian = model.evaluate(trial, uv)
        trial_cost = _cost(levels - trial_value, weight, trial, guess, scale, free)
        better = trial_cost <= cost
        moved = np.linalg.norm(trial[:, :2] - p[:, :2], axis=1)
        p = np.where(better[:, None], trial, p)
        value = np.where(better[:, None], trial_value, value)
        jacobian = np.where(better[:, None, None], trial_jacobian, jacobian)
        damping = np.clip(np.where(better, damping * 0.2, damping * 8.0), 1e-9, 1e9)
        last_move = np.where(better, moved, np.where(done, last_move, 0.5 * last_move))
        done = done | (better & (moved < _MOVED_PX)) | (damping >= 1e9)
        if done.all():
            break
    weight = _weights(levels - value, own, scale)
    covariance, residual = _covariance(
        levels - value, weight, jacobian, p, guess, scale, free, len(span)
    )
    ellipse = _inside_ellipse(p, uv)
    area = np.pi * model.mean_radius(p) ** 2
    seen = np.minimum((ellipse & own).sum(axis=1) / np.maximum(area, 1.0), 1.0)
    p[:, :2] += origin
    moved_far = np.linalg.norm(p[:, :2] - start[which, :2], axis=1) > model.mean_radius(
        start[which]
    )
    return p, covariance, residual, seen, (done | (last_move < _SETTLED_PX)) & ~moved_far


def _pixels_of(
    grey: np.ndarray, origin: np.ndarray, span: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    height, width = grey.shape
    u = origin[:, 0, None].astype(int) + span
    v = origin[:, 1, None].astype(int) + span
    inside = ((v >= 0) & (v < height))[:, :, None] & ((u >= 0) & (u < width))[:, None, :]
    at_v, at_u = np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)
    levels = grey[at_v[:, :, None], at_u[:, None, :]].astype(np.float64)
    return levels.reshape(len(origin), -1), inside.reshape(len(origin), -1)


def _nearest_to_own(
    uv: np.ndarray, p: np.ndarray, origin: np.ndarray, which: np.ndarray, centres: np.ndarray
) -> np.ndarray:
    """Pixels of the window that are nearer to this dot than to any other, and not another's."""
    own = np.ones((len(p), len(uv)), dtype=bool)
    reach = 2.0 * np.abs(uv).max() * np.sqrt(2.0)
    radius = model.mean_radius(p)
    distance2 = ((uv[None] - p[:, None, :2]) ** 2).sum(axis=2)
    for n in range(len(p)):
        offset = centres - (origin[n] + p[n, :2])
        far = np.hypot(offset[:, 0], offset[:, 1])
        near = (far < reach) & (np.arange(len(centres)) != which[n]) & (far > 1e-6)
        for other in offset[near]:
            to_other2 = ((uv - p[n, :2] - other) ** 2).sum(axis=1)
            own[n] &= distance2[n] < to_other2
            # The neighbour's blurred edge belongs to nobody, unless the two dots touch.
            if np.hypot(*other) > 2.6 * radius[n] + 2.0:
                own[n] &= to_other2 > (1.25 * radius[n] + 1.0) ** 2
    return own


def _read_levels(p: np.ndarray, uv: np.ndarray, levels: np.ndarray, own: np.ndarray) -> None:
    """Level around and amplitude of each dot, from medians outside and inside its guess."""
    distance = np.hypot(uv[None, :, 0] - p[:, None, 0], uv[None, :, 1] - p[:, None, 1])
    radius = model.mean_radius(p)[:, None]
    for n in range(len(p)):
        around = levels[n][own[n] & (distance[n] > 1.3 * radius[n])]
        middle = levels[n][own[n] & (distance[n] < max(0.5 * radius[n, 0], 1.0))]
        p[n, model.LEVEL] = np.median(around) if len(around) else np.median(levels[n])
        inner = np.median(middle) if len(middle) else p[n, model.LEVEL]
        p[n, model.CONTRAST] = inner / max(p[n, model.LEVEL], 1.0) - 1.0
    p[:, [model.SLOPE_U, model.SLOPE_V]] = 0.0


def _bounded(p: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Keep ellipse and blur where they mean something."""
    radius = model.mean_radius(guess)
    p = p.copy()
    p[:, model.LOG_BLUR] = np.clip(
        p[:, model.LOG_BLUR], np.log(_MIN_BLUR_PX), np.log(np.maximum(_MAX_BLUR * radius, 0.5))
    )
    low, high = 1.0 / (3.0 * radius), 1.0 / np.maximum(0.3 * radius, 0.5)
    for k in (model.S11, model.S22):
        p[:, k] = np.clip(p[:, k], low, high)
    most = 0.9 * np.sqrt(p[:, model.S11] * p[:, model.S22])
    p[:, model.S12] = np.clip(p[:, model.S12], -most, most)
    return p


def _weights(residual: np.ndarray, own: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Huber's weights about a robust scale that is never below ``scale``; 0 outside ``own``."""
    ordered = np.sort(np.where(own, np.abs(residual), np.inf), axis=1)
    middle = np.maximum(own.sum(axis=1) // 2, 0)
    spread = ordered[np.arange(len(own)), middle] / 0.6745
    spread = np.where(np.isfinite(spread), spread, 0.0)
    bound = _HUBER * np.maximum(spread, scale)[:, None]
    return np.where(own, np.minimum(1.0, bound / np.maximum(np.abs(residual), 1e-12)), 0.0)


def _prior(p: np.ndarray, guess: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights and misses of the weak beliefs about blur and shape, each of shape [dot, 10]."""
    weight = np.zeros_like(p)
    radius = model.mean_radius(guess)
    weight[:, model.LOG_BLUR] = (scale / _PRIOR_BLUR) ** 2
    weight[:, model.SHAPE] = ((scale * radius / _PRIOR_ROUND) ** 2)[:, None]
    return weight, guess - p


def _cost(
    residual: np.ndarray,
    weight: np.ndarray,
    p: np.ndarray,
    guess: np.ndarray,
    scale: np.ndarray,
    free: np.ndarray,
) -> np.ndarray:
    belief, miss = _prior(p, guess, scale)
    return (weight * residual**2).sum(axis=1) + (belief * miss**2)[:, free].sum(axis=1)


def _normal_equations(
    residual: np.ndarray,
    weight: np.ndarray,
    jacobian: np.ndarray,
    p: np.ndarray,
    guess: np.ndarray,
    scale: np.ndarray,
    free: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    weighted = jacobian * weight[..., None]
    normal = np.matmul(weighted.transpose(0, 2, 1), jacobian)
    gradient = np.matmul(weighted.transpose(0, 2, 1), residual[..., None])[..., 0]
    belief, miss = _prior(p, guess, scale)
    np.einsum("nii->ni", normal)[:] += belief
    gradient = gradient + belief * miss
    normal[:, ~free, :] = 0.0
    normal[:, :, ~free] = 0.0
    for k in np.flatnonzero(~free):
        normal[:, k, k] = 1.0
    gradient[:, ~free] = 0.0
    return normal, gradient


def _covariance(
    residual: np.ndarray,
    weight: np.ndarray,
    jacobian: np.ndarray,
    p: np.ndarray,
    guess: np.ndarray,
    scale: np.ndarray,
    free: np.ndarray,
    side: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the centres from the scatter that the fit left, and that scatter."""
    normal, _ = _normal_equations(residual, weight, jacobian, p, guess, scale, free)
    total = weight.sum(axis=1)
    dof = np.maximum(total - free.sum(), 1.0)
    variance = (weight * residual**2).sum(axis=1) / dof
    variance = variance * _neighbours_alike(residual, weight, side)
    good = total > 1.5 * free.sum()
    good &= np.isfinite(normal).all(axis=(1, 2))
    inverse = np.linalg.pinv(normal)[:, :2, :2] * variance[:, None, None]
    unknown = np.broadcast_to(np.diag([np.inf, np.inf]), inverse.shape)
    covariance = np.where(good[:, None, None], inverse, unknown)
    return covariance, np.sqrt(variance)


def _neighbours_alike(residual: np.ndarray, weight: np.ndarray, side: int) -> np.ndarray:
    """Factor on the variance for residuals that neighbours share (blur, compression), >= 1.

    White noise that went through a Gaussian of width s has the correlation exp(-d^2 / 4 s^2) at
    distance d, whose sum is sqrt(4 pi) s along each direction: sqrt(pi / -ln rho) from neighbours'
    correlation rho.
    """
    grid = np.where(weight > 0, residual, 0.0).reshape(len(residual), side, side)
    seen = (weight > 0).reshape(grid.shape)
    power = (grid**2).sum(axis=(1, 2)) / np.maximum(seen.sum(axis=(1, 2)), 1)
    factor = np.ones(len(residual))
    for a, b, m, n in (
        (grid[:, 1:], grid[:, :-1], seen[:, 1:], seen[:, :-1]),
        (grid[:, :, 1:], grid[:, :, :-1], seen[:, :, 1:], seen[:, :, :-1]),
    ):
        both = (a * b).sum(axis=(1, 2)) / np.maximum((m & n).sum(axis=(1, 2)), 1)
        rho = np.clip(both / np.maximum(power, 1e-12), 1e-3, 0.9)
        factor *= np.maximum(np.sqrt(np.pi / -np.log(rho)), 1.0)
    return factor


def _inside_ellipse(p: np.ndarray, uv: np.ndarray) -> np.ndarray:
    q = p[:, :, None]
    du, dv = uv[None, :, 0] - q[:, 0], uv[None, :, 1] - q[:, 1]
    yu = q[:, model.S11] * du + q[:, model.S12] * dv
    yv = q[:, model.S12] * du + q[:, model.S22] * dv
    return yu**2 + yv**2 <= 1.0
