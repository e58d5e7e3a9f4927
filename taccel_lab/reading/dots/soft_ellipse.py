# SPDX-License-Identifier: Apache-2.0
"""The picture of one dot: a soft-edged ellipse in a plane of light, and its derivatives.

``level = (b0 + bu u + bv v) (1 + contrast Phi((1 - q) r / w))`` with ``q = |S d|``: the plane is
the light, of which paint takes a share; ``d`` is the way from the centre, ``S`` is symmetric, its
inverse holds the ellipse's semi-axes, ``r = det(S)^(-1/2)`` is its mean radius, ``w`` the blur of
its edge (camera, and the pixel's own width) and ``Phi`` the normal distribution: the edge of a half
plane seen through a Gaussian blur.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

CENTRE_U, CENTRE_V, S11, S12, S22, LOG_BLUR, CONTRAST, LEVEL, SLOPE_U, SLOPE_V = range(10)
PARAMETERS = 10
SHAPE = slice(S11, S22 + 1)


def circle(radius_px: float | np.ndarray) -> np.ndarray:
    """``S11, S12, S22`` of a circle."""
    one = 1.0 / np.asarray(radius_px, dtype=np.float64)
    return np.stack([one, 0 * one, one], axis=-1)


def mean_radius(parameters: np.ndarray) -> np.ndarray:
    """``det(S)^(-1/2)`` [px] of parameters of shape [..., 10]."""
    s11, s12, s22 = (parameters[..., k] for k in (S11, S12, S22))
    return 1.0 / np.sqrt(np.maximum(s11 * s22 - s12**2, 1e-12))


def semi_axes(parameters: np.ndarray) -> np.ndarray:
    """Longer and shorter semi-axis [px], shape [..., 2]."""
    s11, s12, s22 = (parameters[..., k] for k in (S11, S12, S22))
    mean, half = 0.5 * (s11 + s22), np.hypot(0.5 * (s11 - s22), s12)
    return 1.0 / np.maximum(np.stack([mean - half, mean + half], axis=-1), 1e-6)


def major_direction(parameters: np.ndarray) -> np.ndarray:
    """Unit vector along the longer axis, shape [..., 2]."""
    s11, s12, s22 = (parameters[..., k] for k in (S11, S12, S22))
    angle = 0.5 * np.arctan2(2 * s12, s11 - s22) + 0.5 * np.pi
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def evaluate(parameters: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Levels at pixels and their derivatives.

    Args:
        parameters: Shape [dot, 10], centres relative to the same origin as ``uv``.
        uv: Pixels, shape [pixel, 2], the same for all dots; all is worked out in their precision.

    Returns:
        Levels, shape [dot, pixel], and derivatives, shape [dot, pixel, 10].
    """
    dtype = np.result_type(uv, np.float32)
    p = parameters[:, :, None].astype(dtype, copy=False)
    u, v = uv[None, :, 0], uv[None, :, 1]
    du, dv = u - p[:, CENTRE_U], v - p[:, CENTRE_V]
    s11, s12, s22 = p[:, S11], p[:, S12], p[:, S22]
    yu, yv = s11 * du + s12 * dv, s12 * du + s22 * dv
    q = np.sqrt(yu**2 + yv**2) + 1e-9
    det = np.maximum(s11 * s22 - s12**2, 1e-12)
    steep = np.exp(-p[:, LOG_BLUR]) / np.sqrt(det)
    t = steep - steep * q
    # What is nothing anyway stays a normal number: others take a hundred times as long.
    bell = np.exp(-0.5 * np.minimum(np.square(t), 120.0))
    inside = ndtr(t) if t.dtype == np.float64 else _normal_single(t, bell)
    contrast = p[:, CONTRAST]
    light = p[:, LEVEL] + p[:, SLOPE_U] * u + p[:, SLOPE_V] * v
    edge = light * (contrast / math.sqrt(2 * math.pi)) * bell
    share = 1.0 + contrast * inside

    # One derivative after the other in memory: they are written in half the time.
    jacobian = np.empty((len(p), PARAMETERS, len(uv)), dtype).transpose(0, 2, 1)
    per_y = edge * (steep / q)
    per_yu, per_yv, per_t = per_y * yu, per_y * yv, edge * t
    jacobian[..., CENTRE_U] = s11 * per_yu + s12 * per_yv
    jacobian[..., CENTRE_V] = s12 * per_yu + s22 * per_yv
    # The radius depends on the shape too: d(ln r) = -d(det) / (2 det).
    jacobian[..., S11] = per_t * (-0.5 * s22 / det) - per_yu * du
    jacobian[..., S12] = per_t * (s12 / det) - per_yu * dv - per_yv * du
    jacobian[..., S22] = per_t * (-0.5 * s11 / det) - per_yv * dv
    jacobian[..., LOG_BLUR] = -per_t
    jacobian[..., CONTRAST] = light * inside
    jacobian[..., LEVEL] = share
    jacobian[..., SLOPE_U], jacobian[..., SLOPE_V] = share * u, share * v
    return light * share, jacobian


def _normal_single(t: np.ndarray, bell: np.ndarray) -> np.ndarray:
    """Normal distribution to single precision, where ``bell`` is ``exp(-t^2 / 2)``: a tenth of the
    time of ``ndtr`` (C. Hastings, Approximations for Digital Computers, 1955; M. Abramowitz and
    I. Stegun, Handbook of Mathematical Functions, 1964, 7.1.26, off by 1.5e-7 at most)."""
    k = 1.0 / (1.0 + (0.3275911 / math.sqrt(2.0)) * np.abs(t))
    tail = 1.061405429
    for term in (-1.453152027, 1.421413741, -0.284496736, 0.254829592):
        tail = term + k * tail
    return 0.5 + np.copysign(0.5 - 0.5 * k * tail * bell, t)
