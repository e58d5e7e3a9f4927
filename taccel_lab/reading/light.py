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
from taccel_lab.reading.thumb import SmallImage
from taccel_lab.robust_fit import spread_of_lengths

MIN_BLOCKS = 50
BIWEIGHT = 3.0
"""Residual, in robust standard deviations, beyond which a pixel has no say."""
MIN_SCALE_LEVELS = 1.0
ROUNDED_LEVELS = 0.5
"""Variation of a background that rounding to whole levels may make or take."""
PRIOR_SIGMA = np.array([0.07, 30.0, 10.0, 10.0])
"""Prior spread of gain, offset and the gradient's two parts [1, levels, levels, levels]."""
PRIOR_SAMPLES = 200.0
"""Independent samples that a frame counts as against the prior: neighbours err alike."""
ITERATIONS = 10
STEADY_LEVELS = 0.01
"""Change by an iteration [levels] that asks for no other."""
MOST_AHEAD = 2.0
"""Steps that an iteration goes ahead at most (D. G. Anderson, J. ACM 12, 1965, 547-560)."""
ROWS_AT_ONCE = 16
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

    def on(self, other: LightDrift) -> LightDrift:
        """Light of an image whose untouched one lies in ``other`` itself, against the same."""
        gradient = self.gradient + self.gain[:, None] * other.gradient
        return LightDrift(self.gain * other.gain, self.offset + self.gain * other.offset, gradient)

    def removed(self, levels: np.ndarray) -> np.ndarray:
        """``remove`` from a whole image [height_px, width_px, 3], float32, in single precision."""
        scale = 1.0 / self.gain
        found = cv2.transform(levels, np.column_stack([np.diag(scale), -self.offset * scale]))
        if self.gradient.any():
            height, width = levels.shape[:2]
            u, v = unit_position(height, width)
            right, down = -(self.gradient.T * scale)
            along = np.stack([np.outer(u, right).ravel(), np.tile(down, width)]).astype(np.float32)
            place = np.column_stack([np.ones(height), v]).astype(np.float32)
            rows = found.reshape(height, -1)
            # So many rows at once as stay in a processor's cache.
            for top in range(0, height, ROWS_AT_ONCE):
                rows[top : top + ROWS_AT_ONCE] += place[top : top + ROWS_AT_ONCE] @ along
        return found

    def shift(self, level: np.ndarray) -> np.ndarray:
        """Change of a channel of this ``level`` in the middle of the image [levels], shape [3]."""
        return (self.gain - 1) * level + self.offset

    def within(self, small: SmallImage) -> LightDrift:
        """The same for an image made small, whose outer blocks lie farther in than its pixels."""
        return replace(self, gradient=self.gradient * small.reach)

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
    return np.square(np.maximum(1.0 - np.square(distance / reach), 0.0))


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
    known, seen = (SmallImage.of(image, mask) for image in (background, frame))
    return LightFit(known).still(seen, gradient=gradient)


def fit_press_light(
    frame: np.ndarray, background: np.ndarray, mask: np.ndarray | None = None
) -> LightDrift:
    """``LightFit.press`` of two images; arguments as of ``fit_light``."""
    known, seen = (SmallImage.of(image, mask) for image in (background, frame))
    return LightFit(known).press(seen)


class LightFit:
    """Light of frames against one untouched image, whose side of the fit is made once.

    Fitted are means over blocks: noise of the background would draw the gain to 0 wherever the
    gradient can explain the background as well.
    """

    def __init__(self, known: SmallImage) -> None:
        """``known``: the untouched image. InputError where too few of its pixels count."""
        known = known.blocks
        self._usable = known.usable
        count = int(self._usable.sum())
        if count < _needed(self._usable.size):
            raise InputError(
                f"only {count} of {self._usable.size} blocks of pixels are usable to fit the "
                "light's drift; the mask leaves too few"
            )
        across, down = unit_position(*self._usable.shape)
        rows, columns = np.nonzero(self._usable)
        place = np.stack([across[0, columns], down[rows, 0]]) * known.reach[:, None]
        self._place = np.concatenate([np.ones((1, count)), place])
        self._before = self._samples(known)
        # Levels count from here: moments of what is far from zero lose their digits.
        self._middle = self._before.mean(axis=1, keepdims=True)
        self._before -= self._middle

    def _samples(self, small: SmallImage) -> np.ndarray:
        """Levels of the usable blocks, float64, shape [3, n]."""
        return small.blocks.levels[self._usable].T.astype(np.float64, order="C")

    def still(self, seen: SmallImage, *, gradient: bool = True) -> LightDrift:
        """Light of a frame of the untouched image's pixels, all of it; ``gradient=False`` fits gain
        and offset only."""
        others = self._place if gradient else self._place[:1]
        both = np.concatenate([self._before, self._samples(seen) - self._middle, others])
        covariance = np.zeros((3, 4, 4))
        left = both[3:6] - both[:3]
        left -= np.median(left, axis=1, keepdims=True)
        inside: np.ndarray | slice = slice(None)
        reaches = np.array([np.abs(self._before).max(), *(1.0 for _ in others)])
        taken, last, step = None, None, None
        for _ in range(ITERATIONS):
            distance = np.sqrt(np.einsum("cn,cn->n", left, left))
            scale = max(spread_of_lengths(distance[inside], 3), MIN_SCALE_LEVELS / 3)
            reach = max(np.sqrt(3) * BIWEIGHT * scale, MIN_SCALE_LEVELS)
            weight = biweight(distance, reach)
            inside = weight > 0
            fitted, level, known = _with_prior(both, weight, scale)
            change = None if taken is None else (fitted - taken) * reaches
            if change is not None and np.abs(change).max() < STEADY_LEVELS:
                break
            taken = fitted
            if change is not None:
                if step is not None:
                    # Steps shrink slowly where the gel sinks far around a contact.
                    less = change - step
                    ahead = float((change * less).sum()) / max(float(np.square(less).sum()), 1e-12)
                    taken = fitted - np.clip(ahead, -MOST_AHEAD, 0.5) * (fitted - last)
                step, last = change, fitted
            left = both[3:6] - taken[:, :1] * both[:3] - taken[:, 1:] @ others
        # A gradient that is not fitted is as unknown as its prior says.
        covariance[:, 2:, 2:] = np.diag(PRIOR_SIGMA[2:] ** 2)
        covariance[:, : len(known[0]), : len(known[0])] = known
        gain, middle = fitted[:, 0].copy(), self._middle[:, 0]
        return LightDrift(
            gain=gain,
            offset=fitted[:, 1] + (1.0 - gain) * middle,
            gradient=fitted[:, 2:].copy() if gradient else np.zeros((3, 2)),
            noise_levels=scale,
            covariance=covariance,
            level=middle + level,
        )

    def press(self, seen: SmallImage) -> LightDrift:
        """Light of a frame in which something is pressed into the gel.

        The gel sinks all around a contact, and its colours change with it: smoothly, as a gradient
        or a gain of the light would. So no gradient is fitted, and a gain is believed by the part
        that stands out of what sunk gel feigns (W. James and C. Stein, Proc. 4th Berkeley Symp.,
        1961, 361-379): it is extended to contacts, whose levels lie far beyond those of the gel
        beside them. What either may be all the same is in the covariance. The untouched image is
        best in the mean light of such frames.
        """
        light = self.still(seen, gradient=False)
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
    blocks = SmallImage.of(np.zeros((*mask.shape, 3), np.float32), mask).blocks
    return int(blocks.usable.sum()) >= _needed(blocks.usable.size)


def _needed(blocks: int) -> int:
    return min(MIN_BLOCKS, blocks // 4)


def _with_prior(
    both: np.ndarray, weight: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, offset and gradient of each channel by weighted least squares, drawn weakly to "no
    change", shape [3, p]; the channels' mean levels, shape [3]; the covariance of gain, offset at
    that level and gradient, shape [3, p, p].

    The background has noise of its own, as large as the frame's (half of what is left), which would
    draw the gain to 0. The frame is therefore held against what the background's level is expected
    to be without it: all that offset and gradient explain of it, and of the rest the share that is
    no noise (regression calibration; W. A. Fuller, Measurement Error Models, 1987, section 1.2).
    The matrix is the Gram matrix of those levels plus the prior: never indefinite, and a background
    that is all noise says nothing of the gain. All of it follows from the second moments.

    Args:
        both: Levels of the background, those of the frame, ones, and the place along each axis,
            shape [6 + p - 1, n].
        weight: Of each block, 0..1, shape [n].
        scale: Standard deviation of frame minus background [levels].
    """
    total = float(weight.sum())
    moments = (both * weight) @ both.T
    gram, others_levels, others_wanted = moments[6:, 6:], moments[6:, :3], moments[6:, 3:6]
    # The Gram matrix is singular where blocks lie in a line.
    ridge = 1e-9 * max(total, 1e-9) * np.eye(len(gram))
    explained = np.linalg.solve(gram + ridge, others_levels)
    levels_levels, levels_wanted = moments.diagonal()[:3], moments.diagonal(3)[:3]
    # Levels of their own, beside what is explained, go with none of the others.
    power = np.maximum(levels_levels - (explained * others_levels).sum(axis=0), 0.0)
    noise = 0.5 * total * scale**2
    # Of own levels without any power there is no share, and none that is larger than 0.
    share = 1.0 - noise / np.maximum(power, noise) if noise > 0 else (power > 0).astype(float)
    # Rounding goes with the levels, block by block: what varies by no more tells no gain.
    share = np.where(power > total * ROUNDED_LEVELS**2, share, 0.0)
    # The offset is that at the mean level, so that its prior does not fight the gain's.
    mean = others_levels[0] / total if total > 0 else np.zeros(3)
    expected = explained.copy()
    expected[0] -= mean
    together = gram @ expected
    change = others_wanted - gram @ explained
    own = levels_wanted - (explained * others_wanted).sum(axis=0)
    sigma = PRIOR_SIGMA[: 1 + len(gram)]
    normal = np.empty((3, len(sigma), len(sigma)))
    normal[:, 0, 0] = (expected * together).sum(axis=0) + share**2 * power
    normal[:, 0, 1:] = normal[:, 1:, 0] = together.T
    normal[:, 1:, 1:] = gram
    alike = max(total / PRIOR_SAMPLES, 1.0)
    normal += np.diag(alike * (scale / sigma) ** 2)
    first = (expected * change).sum(axis=0) + share * own - share**2 * power
    inverse = np.linalg.inv(normal)
    step = np.einsum("cij,jc->ci", inverse, np.concatenate([first[None], change]))
    step[:, 1] -= step[:, 0] * mean
    step[:, 0] += 1.0
    return step, mean, alike * scale**2 * inverse


def without_light(image: np.ndarray, background: np.ndarray, light: LightDrift) -> np.ndarray:
    """Frame minus the background in the frame's light [levels], float32."""
    return (image - light.apply(background.astype(np.float32))).astype(np.float32)


def triple(values: np.ndarray) -> tuple[float, float, float]:
    """Values of the three channels as plain numbers."""
    return float(values[0]), float(values[1]), float(values[2])
