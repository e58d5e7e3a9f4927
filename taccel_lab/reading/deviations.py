# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of heights, by what slopes and light may be off by.

Errors of slopes add up along the way, and neighbouring pixels err together: smooth random errors as
large as the slopes' own give heights a standard deviation (``spread_operator``). How far errors
reach (``error_length_px``) and how much too small the spread is are found on presses of known shape
when the model is calibrated.

Such errors cancel around a dent. What readings share does not: a network that was taught the rim of
the contact a pixel too far out reads every dent too steep all around. So the same errors are also
integrated as if all of them lay along the slope (``along_m``). That builds up where slopes are
uncertain, at the rim, stays over the floor of the dent and is gone beside it, as errors of real
presses do.

What the uncertain light of an image does to heights is found once for each sensor, at rest. Gain,
offset and gradient of each channel are known to a covariance. Each of them, off by a little,
changes colours all over the image, and with them slopes and their integral. That is linear in small
errors and hardly depends on what is pressed.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.blocks import LARGEST_PX, enlarged
from taccel_lab.reading.features import of_blocks
from taccel_lab.reading.room import once
from taccel_lab.reading.slope_integration import border_of, height_from_slopes, plane_of
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.reading.spread_operator import Plane, SpreadOperator, spread_operator
from taccel_lab.signals.depth_response import LUMA, DepthResponse
from taccel_lab.signals.tensors import Array, as_given, length2, tensor_of

if TYPE_CHECKING:
    import torch

    from taccel_lab.reading.light import LightDrift

PROBE_LEVELS = 2.0
"""Change of colour that slopes are found for; small beside what they are linear in."""
LOOKS_PER_LENGTH = 4.0
"""Rows and columns per reach of errors that are looked at: they are smooth."""
TINY_SLOPE = 1e-9


class HeightUncertainty:
    """Standard deviations of integrated heights on one pixel grid."""

    def __init__(self, grid: PixelGrid, error_length_px: float) -> None:
        """
        Args:
            grid: The pixel grid of the slopes.
            error_length_px: Standard deviation of the Gaussian that errors are smooth over [px].
        """
        self.grid, self.error_length_px = grid, error_length_px
        self.every = max(1, int(error_length_px / LOOKS_PER_LENGTH))
        """Rows and columns apart that are looked at."""
        self.part = (..., *(np.s_[self.every // 2 :: self.every],) * 2)
        """Rows and columns that are looked at."""

    def sigma_m(self, slope_sigma: Array, *, weights: Any = None, zero: Any = None) -> Array:
        """Standard deviation of the height [m], shape [..., height_px, width_px].

        Args:
            slope_sigma: Standard deviation of each component of the slope, shape [..., h, w].
            weights: As the heights were integrated with. Slopes of weight 0 count as exact.
            zero: Pixels that the height is counted from, likewise.
        """
        operator, sigma, counted, plane = self._seen(slope_sigma[self.part], weights, zero)
        return as_given(operator.sigma_m(operator.at_points(sigma, counted), plane), slope_sigma)

    def along_m(
        self, slope: Array, slope_sigma: Array, *, weights: Any = None, zero: Any = None
    ) -> Array:
        """Height [m], shape [..., height_px, width_px], that is gained or lost where each slope
        from rest, shape [..., h, w, 2], is steeper or flatter by its standard deviation; the rest
        as in ``sigma_m``. A slope below its deviation has no direction that errors lie along: they
        count as much less as it is below, whether noise is averaged over blocks or not."""
        looks = slope[(*self.part, slice(None))], slope_sigma[self.part]
        return self.both_m(*looks, weights=weights, zero=zero)[1]

    def both_m(
        self, slope: Array, slope_sigma: Array, *, weights: Any = None, zero: Any = None
    ) -> tuple[Array, Array]:
        """``sigma_m`` and ``along_m``, from slopes of ``part`` alone."""
        import torch

        operator, sigma, counted, plane = self._seen(slope_sigma, weights, zero)
        spread = operator.sigma_m(operator.at_points(sigma, counted), plane)
        slopes = tensor_of(slope, torch.float64)
        steepness = torch.maximum(length2(slopes), sigma).clamp(min=TINY_SLOPE)
        error = operator.at_points(slopes.movedim(-1, 0) * (sigma / steepness), counted)
        along = operator.height_m(error, plane).abs_()
        return as_given(spread, slope_sigma), as_given(along, slope_sigma)

    def _seen(
        self, slope_sigma: Array, weights: Any, zero: Any
    ) -> tuple[SpreadOperator, torch.Tensor, torch.Tensor | None, Plane]:
        """The operator, standard deviations of slopes, their weights, and the plane at rest."""
        import torch

        sigma = tensor_of(slope_sigma, torch.float64)
        mask = b""
        if weights is not None:
            weights = tensor_of(weights, like=sigma)
            mask = once("deviations' mask", partial(_packed, weights))
            weights = weights[self.part].to(torch.float64)
        operator = spread_operator(self.grid, self.error_length_px, self.every, sigma.device, mask)
        if zero is not None:
            # Bytes become numbers in a quarter of the time that bits do.
            zero = tensor_of(zero, torch.bool, sigma).view(torch.uint8).to(torch.float32)
        return operator, sigma, weights, operator.plane(zero)


def _packed(weights: torch.Tensor) -> bytes:
    """Pixels that count, as bits; none where all do."""
    kept = weights > 0
    return b"" if bool(kept.all()) else np.packbits(kept.cpu().numpy()).tobytes()


class LightErrors:
    """Heights' standard deviations by the light, for images of one sensor."""

    def __init__(
        self,
        model: NormalModel,
        background: np.ndarray,
        grid: PixelGrid,
        mask: np.ndarray | None = None,
        rest_normals: np.ndarray | None = None,
    ) -> None:
        """
        Args:
            model: From colours to normals.
            background: The untouched sensor, RGB levels, shape [height_px, width_px, 3].
            grid: Pixel grid of the images.
            mask: Pixels that count, bool, shape [height_px, width_px].
            rest_normals: Of the face at rest, shape [h, w, 3]; flat when None.
        """
        from taccel_lab.reading.light import LightDrift

        every = LARGEST_PX
        self._level = background.reshape(-1, 3).mean(axis=0)
        terms = LightDrift(np.ones(3), np.zeros(3), level=self._level).terms(background)
        rest = 0.0
        if rest_normals is not None:
            thin = of_blocks(rest_normals, every)
            rest = thin[..., :2] / thin[..., 2:]
        thinned = grid.thinned(every)
        slopes = np.empty((3, 4, thinned.height_px, thinned.width_px, 2))
        for channel in range(3):
            for k, term in enumerate(terms):
                probe = PROBE_LEVELS / max(float(np.abs(term[..., channel]).max()), 1e-9)
                image = background.astype(np.float32)
                image[..., channel] += probe * term[..., channel]
                read = model.predict(
                    image, background, mask=mask, rest_normals=rest_normals, every=every
                )
                slopes[channel, k] = (read.slopes() + rest) / probe
        weights = None if mask is None else of_blocks(mask, every)
        self._heights = tensor_of(height_from_slopes(slopes, thinned, weights=weights))
        self._border = border_of((thinned.height_px, thinned.width_px), self._heights)

    def sigma_m(
        self, lights: Sequence[LightDrift], zero: np.ndarray, every: int
    ) -> list[np.ndarray]:
        """Standard deviations of the heights [m] for each light of one image, [h, w].

        Args:
            lights: Of the image against the background.
            zero: Blocks that its heights are counted from, as of ``ReadHeights``, [h, w].
            every: Pixels along these blocks, at most ``LARGEST_PX``.
        """
        times = LARGEST_PX // every
        at_rest = tensor_of(zero[::times, ::times])
        at_rest = at_rest if at_rest.any() else self._border
        heights = (self._heights - plane_of(self._heights, at_rest)).flatten(-2).numpy()
        found = []
        for light in lights:
            products = light.covariance_at(self._level) @ heights
            variance = np.einsum("ckp,ckp->p", heights, products)
            sigma = np.sqrt(np.maximum(variance, 0.0), dtype=np.float32)
            found.append(sigma.reshape(self._border.shape))
        if times == 1:
            return found
        lines = enlarged(tensor_of(np.stack(found)), times)[..., : zero.shape[0], : zero.shape[1]]
        # Lines that go on beyond the outermost blocks may fall below any deviation there is.
        return [np.maximum(one, low.min()) for one, low in zip(lines.numpy(), found, strict=True)]


def together(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Standard deviation of a sum of independent errors; a third of the time of ``hypot``."""
    total = np.square(one)
    total += np.square(other)
    return np.sqrt(total, out=total)


def grey_light_sigma_mm(
    response: DepthResponse, light: LightDrift, background: np.ndarray, depth_mm: np.ndarray
) -> np.ndarray:
    """The same of a grey sensor, whose depths follow the curve ``response`` pixel by pixel [mm].

    ``background``: untouched sensor, RGB levels, shape [h, w, 3]; ``depth_mm``: what is read, shape
    [h, w].
    """
    names = ("red", "green", "blue")
    shares = (
        LUMA
        if response.channel == "grey"
        else np.array([float(name == response.channel) for name in names])
    )
    terms = light.terms(background)
    variance = np.zeros(depth_mm.size)
    for channel, share in enumerate(shares):
        if share > 0:
            each = terms[..., channel].reshape(len(terms), -1)
            variance += share**2 * np.einsum("kp,kp->p", light.covariance[channel] @ each, each)
    drop = response.drop_of(depth_mm)
    per_level = response.depth_of(drop + 1.0) - response.depth_of(drop)
    return per_level * np.sqrt(np.maximum(variance, 0.0)).reshape(depth_mm.shape)
