# SPDX-License-Identifier: Apache-2.0
"""Fit of one frame's light against the background.

Contacts and shadows are outliers of the light's law: the fit is an iteratively reweighted least
squares with Tukey's biweight (J. W. Tukey and A. E. Beaton, Technometrics 16, 1974) on the distance
over all channels, so that nobody has to say where the contact is. What a flat background cannot
tell is held by a weak prior at "no change".
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.calibration.light_drift import LightDrift, unit_position
from taccel_lab.calibration.robust_spread import spread_of_lengths
from taccel_lab.calibration.smoothing import smoothed
from taccel_lab.errors import InputError

SAMPLE_COUNT = 8000
"""Pixels that the robust fit looks at, on a regular lattice."""
MIN_PIXELS = 200
BIWEIGHT = 3.0
"""Residual, in robust standard deviations, beyond which a pixel has no say."""
MIN_SCALE_LEVELS = 1.0
PRIOR_SIGMA = np.array([0.07, 30.0, 10.0, 10.0])
"""Prior spread of gain, offset and the gradient's two parts [1, levels, levels, levels]."""
PRIOR_SAMPLES = 200.0
"""Independent samples that a frame counts as against the prior: neighbours err alike."""
SMOOTHING_SHARE = 1 / 160
"""Smoothing before the fit, as a part of the shorter side. Noise of the background would draw the
gain to 0 wherever the gradient can explain the background as well."""
ITERATIONS = 12
GAIN_DOUBT = 0.03
"""Gain that sunk gel feigns: over 48 presses in one light (Taxim) a standard deviation of 0.02 to
0.03."""
GRADIENT_DOUBT_LEVELS = 1.5
"""Standard deviation of a gradient that a press may hide: half of a lamp that has become 3 % weaker
on one side."""


def biweight(distance: np.ndarray, reach: float) -> np.ndarray:
    """Tukey's weight of residuals: 1 at zero, 0 from ``reach`` on; of their shape."""
    return np.clip(1 - (distance / reach) ** 2, 0.0, 1.0) ** 2


def fit_light(
    frame: np.ndarray,
    background: np.ndarray,
    mask: np.ndarray | None = None,
    *,
    gradient: bool = True,
) -> LightDrift:
    """Light of ``frame`` against ``background`` wherever the two go together.

    Images are RGB levels, shape [height_px, width_px, 3]; pixels where ``mask`` is false are left
    out. The untouched part has to be the larger one. ``gradient=False`` fits gain and offset only.
    """
    height, width = background.shape[:2]
    rows, columns = _samples(np.ones((height, width), bool) if mask is None else mask)
    if len(rows) < _needed(height, width):
        raise InputError(
            f"only {len(rows)} usable pixels to fit the light's drift; the mask leaves too few"
        )
    u, v = unit_position(height, width)
    place = np.stack([np.ones(len(rows)), u[0, columns], v[rows, 0]])
    others = place if gradient else place[:1]
    sigma = max(min(height, width) * SMOOTHING_SHARE, 1.0)
    before, after = (
        smoothed(image, mask, sigma)[rows, columns].T.astype(np.float64, order="C")
        for image in (background, frame)
    )
    fitted, covariance = np.zeros((3, 1 + len(others))), np.zeros((3, 4, 4))
    left = after - before
    left -= np.median(left, axis=1, keepdims=True)
    weight = np.ones(len(rows))
    scale = MIN_SCALE_LEVELS
    for k in range(ITERATIONS):
        distance = np.sqrt(np.square(left).sum(axis=0))
        inside = distance[weight > 0] if k else distance
        scale = max(spread_of_lengths(inside, 3), MIN_SCALE_LEVELS / 3)
        reach = max(np.sqrt(3) * BIWEIGHT * scale, MIN_SCALE_LEVELS)
        weight = biweight(distance, reach)
        fitted, level, known = _with_prior(before, others, after, weight, scale)
        left = after - before * fitted[:, :1] - fitted[:, 1:] @ others
    # A gradient that is not fitted is as unknown as its prior says.
    covariance[:, 2:, 2:] = np.diag(PRIOR_SIGMA[2:] ** 2)
    covariance[:, : len(known[0]), : len(known[0])] = known
    return LightDrift(
        gain=fitted[:, 0].copy(),
        offset=fitted[:, 1].copy(),
        gradient=fitted[:, 2:].copy() if gradient else np.zeros((3, 2)),
        noise_levels=scale,
        covariance=covariance,
        level=level,
    )


def fit_press_light(
    frame: np.ndarray, background: np.ndarray, mask: np.ndarray | None = None
) -> LightDrift:
    """``fit_light`` of a frame in which something is pressed into the gel.

    The gel sinks all around a contact, and its colours change with it: smoothly, as a gradient or a
    gain of the light would. So no gradient is fitted, and a gain is believed by the part that
    stands out of what sunk gel feigns (W. James and C. Stein, Proc. 4th Berkeley Symp., 1961,
    361-379): it is extended to contacts, whose levels lie far beyond those of the gel beside them.
    What either may be all the same is in the covariance. ``background`` is best in the mean light
    of such frames.
    """
    light = fit_light(frame, background, mask, gradient=False)
    off = light.gain - 1.0
    kept = off * np.maximum(1.0 - (GAIN_DOUBT / np.maximum(np.abs(off), 1e-9)) ** 2, 0.0)
    covariance = light.covariance.copy()
    covariance[:, 0, 0] = GAIN_DOUBT**2
    covariance[:, 0, 1] = covariance[:, 1, 0] = 0.0
    covariance[:, 2:, 2:] = GRADIENT_DOUBT_LEVELS**2 * np.eye(2)
    # The same change at the level that the gain turns about.
    offset = light.offset + (off - kept) * light.level
    return replace(light, gain=1.0 + kept, offset=offset, covariance=covariance)


def enough_pixels(mask: np.ndarray) -> bool:
    """Whether ``fit_light`` takes a light by the pixels of ``mask``, [height_px, width_px]."""
    return len(_samples(mask)[0]) >= _needed(*mask.shape)


def _needed(height: int, width: int) -> int:
    return min(MIN_PIXELS, height * width // 4)


def _samples(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the lattice's pixels in ``mask``."""
    height, width = mask.shape
    step = max(1, int(np.sqrt(height * width / SAMPLE_COUNT)))
    rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    usable = mask[rows, columns]
    return rows[usable], columns[usable]


def _with_prior(
    levels: np.ndarray, others: np.ndarray, wanted: np.ndarray, weight: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, offset and gradient of each channel by weighted least squares, drawn weakly to "no
    change", shape [3, p]; the channels' mean levels, shape [3]; the covariance of gain, offset at
    that level and gradient, shape [3, p, p].

    The background has noise of its own, as large as the frame's (half of what is left), which would
    draw the gain to 0. The frame is therefore held against what the background's level is expected
    to be without it: all that offset and gradient explain of it, and of the rest the share that is
    no noise (regression calibration; W. A. Fuller, Measurement Error Models, 1987, section 1.2).
    The matrix is the Gram matrix of those levels plus the prior: never indefinite, and a background
    that is all noise says nothing of the gain.

    Args:
        levels: Of the background, shape [3, n].
        others: Ones, and the place along each axis, shape [p - 1, n].
        wanted: Levels of the frame, shape [3, n].
        weight: Of each pixel, 0..1, shape [n].
        scale: Standard deviation of frame minus background [levels].
    """
    sigma = PRIOR_SIGMA[: 1 + len(others)]
    total = float(weight.sum())
    weighed = others * weight
    gram = weighed @ others.T
    # Least squares of the Gram matrix, which is singular where pixels lie in a line.
    explained = np.linalg.lstsq(gram, weighed @ levels.T, rcond=None)[0].T @ others
    own = levels - explained
    power = np.square(own) @ weight
    noise = 0.5 * total * scale**2
    # Of own levels without any power there is no share, and none that is larger than 0.
    share = 1.0 - noise / np.maximum(power, noise) if noise > 0 else (power > 0).astype(float)
    expected = explained + share[:, None] * own
    change = wanted - expected
    # The offset is that at the mean level, so that its prior does not fight the gain's.
    mean = levels @ weight / total if total > 0 else np.zeros(len(levels))
    expected -= mean[:, None]
    normal = np.empty((len(levels), len(sigma), len(sigma)))
    normal[:, 0, 0] = np.square(expected) @ weight
    normal[:, 0, 1:] = normal[:, 1:, 0] = expected @ weighed.T
    normal[:, 1:, 1:] = gram
    alike = max(total / PRIOR_SAMPLES, 1.0)
    normal += np.diag(alike * (scale / sigma) ** 2)
    side = np.column_stack([(expected * change) @ weight, change @ weighed.T])
    step = np.linalg.solve(normal, side[..., None])[..., 0]
    step[:, 1] -= step[:, 0] * mean
    step[:, 0] += 1.0
    return step, mean, alike * scale**2 * np.linalg.inv(normal)


def without_light(image: np.ndarray, background: np.ndarray, light: LightDrift) -> np.ndarray:
    """Frame minus the background in the frame's light [levels], float32."""
    return (image - light.apply(background.astype(np.float32))).astype(np.float32)
