# SPDX-License-Identifier: Apache-2.0
"""Fit of one frame's light against the background.

Contacts and shadows are outliers of the light's law: the fit is an iteratively reweighted least
squares with Tukey's biweight (J. W. Tukey and A. E. Beaton, Technometrics 16, 1974) on the distance
over all channels, so that nobody has to say where the contact is. What a flat background cannot
tell is held by a weak prior at "no change".
"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.light.light import Light, unit_position
from taccel_lab.calibration.light.smoothing import smoothed
from taccel_lab.calibration.robust_spread import spread_of_lengths
from taccel_lab.errors import InputError

SAMPLE_COUNT = 8000
"""Pixels that the robust fit looks at, on a regular lattice."""
MIN_PIXELS = 200
CLIPPED_LEVELS = 252.0
"""Smoothed levels above which a pixel of 8 bits may be clipped: a level of noise below 255."""
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
STEADY_GAIN, STEADY_LEVELS = 1e-4, 0.02
"""Changes from one iteration to the next, a tenth of what a level of 8 bits tells, that end it."""


def biweight(distance: np.ndarray, reach: float) -> np.ndarray:
    """Tukey's weight of residuals: 1 at zero, 0 from ``reach`` on; of their shape."""
    return np.clip(1 - (distance / reach) ** 2, 0.0, 1.0) ** 2


class LightFit:
    """Fits the light of frames against one background, whose own part of the work is done once."""

    def __init__(
        self,
        background: np.ndarray,
        mask: np.ndarray | None = None,
        sample_count: int = SAMPLE_COUNT,
    ) -> None:
        """Of frames of the size of ``background``, RGB levels, shape [height_px, width_px, 3], by
        about ``sample_count`` pixels; those where ``mask``, bool, is false are left out. Raises
        InputError where too few are left."""
        height, width = background.shape[:2]
        self._mask, self._lattice = mask, _lattice(height, width, sample_count)
        self.counts = np.ones((height, width), bool) if mask is None else np.asarray(mask, bool)
        self.counts = self.counts[self._lattice]
        """Which pixels of the lattice are used, bool, shape [rows, columns]."""
        if self.counts.sum() < _needed(height, width):
            raise InputError(
                f"only {int(self.counts.sum())} usable pixels to fit the light's drift; the mask "
                "leaves too few"
            )
        u, v = unit_position(height, width)
        places = (np.ones((height, width)), *np.broadcast_arrays(u, v))
        self._places = np.stack([place[self._lattice] for place in places])
        self.before = self.sampled(background)
        """The background on the lattice, smoothed [levels], shape [rows, columns, 3]."""

    def sampled(self, image: np.ndarray) -> np.ndarray:
        """An image on the lattice, smoothed [levels], shape [rows, columns, 3]."""
        sigma = max(min(image.shape[:2]) * SMOOTHING_SHARE, 1.0)
        return smoothed(image, self._mask, sigma)[self._lattice]

    def shown(self, light: Light) -> np.ndarray:
        """The background on the lattice as ``light`` shows it [levels], [rows, columns, 3]."""
        shown = self.before * light.gain + light.offset
        if light.gradient.any():
            shown += np.einsum("krc,jk->rcj", self._places[1:], light.gradient)
        return shown

    def removed(self, frame: np.ndarray, light: Light) -> np.ndarray:
        """A ``sampled`` frame as the background's light would show it, [rows, columns, 3]."""
        return (frame - (self.shown(light) - self.before * light.gain)) / light.gain

    def fit(self, frame: np.ndarray, *, gradient: bool = True) -> Light:
        """Light of a ``sampled`` frame wherever it and the background go together; the untouched
        part has to be the larger one. ``gradient=False`` fits gain and offset only."""
        # Clipped pixels tell a bound of their level alone; where hardly others are, it has to do.
        clipped = np.maximum(frame, self.before).max(axis=-1) > CLIPPED_LEVELS
        used = self.counts & ~clipped
        if used.sum() < MIN_PIXELS:
            used = self.counts
        others = self._places[: 3 if gradient else 1, used]
        before, after = (
            image[used].T.astype(np.float64, order="C") for image in (self.before, frame)
        )
        fitted = np.zeros((3, 1 + len(others)))
        left = after - before
        left -= np.median(left, axis=1, keepdims=True)
        weight = np.ones(before.shape[1])
        scale = MIN_SCALE_LEVELS
        for k in range(ITERATIONS):
            distance = np.sqrt(np.square(left).sum(axis=0))
            inside = distance[weight > 0] if k else distance
            scale = max(spread_of_lengths(inside, 3), MIN_SCALE_LEVELS / 3)
            reach = max(np.sqrt(3) * BIWEIGHT * scale, MIN_SCALE_LEVELS)
            weight = biweight(distance, reach)
            last, fitted = fitted, _with_prior(before, others, after, weight, scale)
            left = after - before * fitted[:, :1] - fitted[:, 1:] @ others
            if np.abs(fitted - last)[:, 0].max() < STEADY_GAIN and (
                np.abs(fitted - last)[:, 1:].max() < STEADY_LEVELS
            ):
                break
        return Light(
            gain=fitted[:, 0].copy(),
            offset=fitted[:, 1].copy(),
            gradient=fitted[:, 2:].copy() if gradient else np.zeros((3, 2)),
            noise_levels=scale,
        )


def fit_light(
    frame: np.ndarray,
    background: np.ndarray,
    mask: np.ndarray | None = None,
    *,
    gradient: bool = True,
) -> Light:
    """Light of one frame against one background, as ``LightFit`` has it."""
    fit = LightFit(background, mask)
    return fit.fit(fit.sampled(frame), gradient=gradient)


def enough_pixels(mask: np.ndarray) -> bool:
    """Whether a light is fitted by the pixels of ``mask`` alone, [height_px, width_px]."""
    return int(mask[_lattice(*mask.shape)].sum()) >= _needed(*mask.shape)


def _needed(height: int, width: int) -> int:
    return min(MIN_PIXELS, height * width // 4)


def _lattice(height: int, width: int, count: int = SAMPLE_COUNT) -> tuple[slice, slice]:
    """Rows and columns of a regular lattice of about ``count`` pixels."""
    step = max(1, int(np.sqrt(height * width / count)))
    return slice(step // 2, None, step), slice(step // 2, None, step)


def _with_prior(
    levels: np.ndarray, others: np.ndarray, wanted: np.ndarray, weight: np.ndarray, scale: float
) -> np.ndarray:
    """Weighted least squares, drawn weakly to "no change", shape [3, p]."""
    sigma = PRIOR_SIGMA[: 1 + len(others)]
    normal, side = normal_equations(levels, others, wanted, weight, scale, sigma)
    step = np.linalg.solve(normal, side[..., None])[..., 0]
    step[:, 1] -= step[:, 0] * _mean_levels(levels, weight)
    step[:, 0] += 1.0
    return step


def _mean_levels(levels: np.ndarray, weight: np.ndarray) -> np.ndarray:
    total = weight.sum()
    return levels @ weight / total if total > 0 else np.zeros(len(levels))


def normal_equations(
    levels: np.ndarray,
    others: np.ndarray,
    wanted: np.ndarray,
    weight: np.ndarray,
    scale: float,
    prior_sigma: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Of each channel, the matrix [3, p, p] and right side [3, p] for gain - 1, offset at the mean
    level, and gradient.

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
        prior_sigma: Prior spread of each unknown, shape [p].
    """
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
    expected -= _mean_levels(levels, weight)[:, None]
    normal = np.empty((len(levels), len(prior_sigma), len(prior_sigma)))
    normal[:, 0, 0] = np.square(expected) @ weight
    normal[:, 0, 1:] = normal[:, 1:, 0] = expected @ weighed.T
    normal[:, 1:, 1:] = gram
    normal += np.diag(max(total / PRIOR_SAMPLES, 1.0) * (scale / prior_sigma) ** 2)
    side = np.column_stack([(expected * change) @ weight, change @ weighed.T])
    return normal, side


def without_light(image: np.ndarray, background: np.ndarray, light: Light) -> np.ndarray:
    """Frame minus the background in the frame's light [levels], float32."""
    return (image - light.apply(background.astype(np.float32))).astype(np.float32)
