# SPDX-License-Identifier: Apache-2.0
"""The picture of one dot: a soft-edged ellipse in a plane of light, and its derivatives.

``level = (b0 + bu u + bv v) (1 + contrast Phi((1 - q) r / w))`` with ``q = |S d|``: the plane is
the light, of which paint takes a share; ``d`` is the way from the centre, ``S`` is symmetric, its
inverse holds the ellipse's semi-axes, ``r = det(S)^(-1/2)`` is its mean radius, ``w`` the blur of
its edge (camera, and the pixel's own width) and ``Phi`` the normal distribution: the edge of a half
plane seen through a Gaussian blur.
"""

from __future__ import annotations

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
        uv: Pixels, shape [pixel, 2], the same for all dots.

    Returns:
        Levels, shape [dot, pixel], and derivatives, shape [dot, pixel, 10].
    """
    p = parameters[:, :, None]
    u, v = uv[None, :, 0], uv[None, :, 1]
    du, dv = u - p[:, CENTRE_U], v - p[:, CENTRE_V]
    s11, s12, s22 = p[:, S11], p[:, S12], p[:, S22]
    yu, yv = s11 * du + s12 * dv, s12 * du + s22 * dv
    q = np.sqrt(yu**2 + yv**2) + 1e-9
    det = np.maximum(s11 * s22 - s12**2, 1e-12)
    radius = 1.0 / np.sqrt(det)
    blur = np.exp(p[:, LOG_BLUR])
    t = (1.0 - q) * radius / blur
    inside = ndtr(t)
    contrast = p[:, CONTRAST]
    light = p[:, LEVEL] + p[:, SLOPE_U] * u + p[:, SLOPE_V] * v
    edge = light * contrast * np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi)
    share = 1.0 + contrast * inside

    # One derivative after the other in memory: they are written in half the time.
    jacobian = np.empty((len(p), PARAMETERS, len(uv))).transpose(0, 2, 1)
    per_q = -edge * radius / blur
    jacobian[..., CENTRE_U] = -per_q * (s11 * yu + s12 * yv) / q
    jacobian[..., CENTRE_V] = -per_q * (s12 * yu + s22 * yv) / q
    # The radius depends on the shape too: d(ln r) = -d(det) / (2 det).
    per_det = -edge * t / (2 * det)
    jacobian[..., S11] = per_q * yu * du / q + per_det * s22
    jacobian[..., S12] = per_q * (yu * dv + yv * du) / q - 2 * per_det * s12
    jacobian[..., S22] = per_q * yv * dv / q + per_det * s11
    jacobian[..., LOG_BLUR] = -edge * t
    jacobian[..., CONTRAST] = light * inside
    jacobian[..., LEVEL] = share
    jacobian[..., SLOPE_U], jacobian[..., SLOPE_V] = share * u, share * v
    return light * share, jacobian
