# SPDX-License-Identifier: Apache-2.0
"""The light of a frame against that of the background: gain, offset and a linear gradient.

Ageing lamps, a warm camera and above all automatic white balance change every frame a little. In a
frame without contact each channel follows ``frame = gain * background + offset + gradient``, the
gradient being linear over the image.

Contacts and shadows are outliers of that law: the fit is an iteratively reweighted least squares
with Tukey's biweight (J. W. Tukey and A. E. Beaton, Technometrics 16, 1974) on the distance over
all channels, so that nobody has to say where the contact is. What a flat background cannot tell is
held by a weak prior at "no change".
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.robust_fit import spread_of_lengths

SAMPLE_COUNT = 8000
"""Pixels that an image's light is fitted to, on a regular lattice."""
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


@dataclass(frozen=True)
class LightDrift:
    """Light of an image against another's: ``image = gain * other + offset + gradient``."""

    gain: np.ndarray
    """Gain of each channel, shape [3]."""
    offset: np.ndarray
    """Offset of each channel [levels], shape [3]."""
    gradient: np.ndarray = field(default_factory=lambda: np.zeros((3, 2)))
    """Change from the middle to the right and to the lower border [levels], shape [3, 2]."""
    noise_levels: float = 0.0
    """Robust standard deviation of what is left of the smoothed frame, a channel [levels]; 0 when
    not estimated."""
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 4, 4)))
    """Covariance of gain, of the offset at ``level`` [levels], and of the gradient's two parts
    [levels], shape [3, 4, 4]; zero where nothing was fitted."""
    level: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Mean level of each channel that the gain turns about [levels], shape [3]."""

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The background (or a render on it) as the frame's light would show it.

        A gradient needs a whole image, shape [height_px, width_px, 3].
        """
        rows, gain, offset = self._by_rows(image)
        return (rows * gain + offset + self._plane(image)).reshape(image.shape)

    def remove(self, image: np.ndarray) -> np.ndarray:
        """The frame as the background's light would show it."""
        rows, gain, offset = self._by_rows(image)
        return ((rows - offset - self._plane(image)) / gain).reshape(image.shape)

    def shift(self, level: np.ndarray) -> np.ndarray:
        """Change of a channel of this ``level`` in the middle of the image [levels], shape [3]."""
        return (self.gain - 1) * level + self.offset

    def at(self, pixel_idx: np.ndarray, height_px: int, width_px: int) -> LightDrift:
        """The same for some pixels of an image, counted along rows, shape [n]: the gradient there
        is part of ``offset``, shape [n, 3]."""
        u, v = unit_position(height_px, width_px)
        rows, columns = np.divmod(pixel_idx, width_px)
        there = u[0, columns, None] * self.gradient[:, 0] + v[rows, 0, None] * self.gradient[:, 1]
        return LightDrift(self.gain, self.offset + there, noise_levels=self.noise_levels)

    def terms(self, background: np.ndarray) -> np.ndarray:
        """What a unit of each parameter adds to each channel of an untouched frame, in the order of
        ``covariance``, shape [4, height_px, width_px, 3]."""
        u, v = unit_position(*background.shape[:2])
        found = np.empty((4, *background.shape))
        found[0] = background - self.level
        found[1], found[2], found[3] = 1.0, u[..., None], v[..., None]
        return found

    def covariance_at(self, level: np.ndarray) -> np.ndarray:
        """``covariance`` with the offset taken at another ``level`` of the channels, [3, 4, 4]."""
        moved = np.tile(np.eye(4), (3, 1, 1))
        moved[:, 1, 0] = level - self.level
        return moved @ self.covariance @ moved.transpose(0, 2, 1)

    def _by_rows(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An image with one axis for columns and channels, gain and offset along it: an axis of
        three alone takes four times as long. Pixels in a list stay as they are."""
        if image.ndim != 3:
            return image, self.gain, self.offset
        height, width = image.shape[:2]
        rows = image.reshape(height, -1)
        return rows, np.tile(self.gain, width), np.tile(self.offset, width)

    def _plane(self, image: np.ndarray) -> np.ndarray | float:
        """Levels that the gradient adds, in the shape of ``_by_rows``."""
        if not self.gradient.any():
            return 0.0
        if image.ndim != 3:
            raise InputError(f"a drift with a gradient needs a whole image, got {image.shape}")
        u, v = unit_position(image.shape[0], image.shape[1])
        across = np.outer(u, self.gradient[:, 0]).ravel()
        return across + np.tile(v * self.gradient[:, 1], image.shape[1])


def unit_position(height_px: int, width_px: int) -> tuple[np.ndarray, np.ndarray]:
    """-1..1 over the columns [1, width_px] and over the rows [height_px, 1]."""
    return np.linspace(-1, 1, width_px)[None, :], np.linspace(-1, 1, height_px)[:, None]


def smoothed(image: np.ndarray, mask: np.ndarray | None, sigma_px: float) -> np.ndarray:
    """Gaussian mean [sigma_px] over the usable pixels only, float32, same shape as ``image``.

    Where no usable pixel is near, the value is 0.
    """
    if mask is None or mask.all():
        return cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), sigma_px)
    channels = (...,) + (None,) * (image.ndim - mask.ndim)
    filled = np.where(mask[channels], image, 0.0).astype(np.float32)
    total = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma_px)[channels]
    spread = cv2.GaussianBlur(filled, (0, 0), sigma_px)
    return np.where(total > 1e-3, spread / np.maximum(total, 1e-3), 0.0).astype(np.float32)


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
    rows, columns = lattice_pixels(np.ones((height, width), bool) if mask is None else mask)
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
    return len(lattice_pixels(mask)[0]) >= _needed(*mask.shape)


def _needed(height: int, width: int) -> int:
    return min(MIN_PIXELS, height * width // 4)


def lattice_pixels(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of some ``SAMPLE_COUNT`` pixels of a regular lattice, those in ``mask``,
    bool, [height_px, width_px]."""
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


def triple(values: np.ndarray) -> tuple[float, float, float]:
    """Values of the three channels as plain numbers."""
    return float(values[0]), float(values[1]), float(values[2])
