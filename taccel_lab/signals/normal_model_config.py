# SPDX-License-Identifier: Apache-2.0
"""Settings of the networks from colours to normals, and the features that they ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.signals.model_settings import reading_settings, settings_dict
from taccel_lab.signals.normal_features import feature_names, local_features, pixel_place
from taccel_lab.signals.position_encoding import require_bands

OUTPUTS = 3
"""Two tilts [rad] and the logarithm of the expected angle of error [rad]."""
RAYLEIGH_95 = math.sqrt(-2.0 * math.log(0.05))
"""Length that 95 % of vectors of two independent normal deviates of unit standard deviation stay
below."""


@dataclass(frozen=True)
class NormalModelConfig:
    """Everything besides the weights that is needed to rebuild a ``NormalModel``."""

    width_px: int
    height_px: int
    scales_px: tuple[float, ...] = (1.0, 3.0, 8.0)
    """Standard deviations of the windows over which the colour change is averaged [px]."""
    slope_scales_px: tuple[float, ...] = (3.0, 8.0)
    """Windows of which the variation across the image is a feature as well [px]."""
    background: bool = False
    """Whether the colour of the untouched pixel is a feature."""
    members: int = 4
    """Networks in the ensemble."""
    hidden: tuple[int, ...] = (32, 32, 32)
    """Widths of the hidden layers."""
    input_mean: tuple[float, ...] = ()
    """Subtracted from each feature; zeros when empty."""
    input_scale: tuple[float, ...] = ()
    """Divides each feature after that; ones when empty."""
    error_factor: float = 1.0
    """Factor on the expected error, found on presses that the member did not see."""
    radius95_sigmas: float = RAYLEIGH_95
    """Standard deviations within which 95 % of the normals lie, found on such presses too: errors
    have longer tails than normal ones."""
    position_bands: int = 0
    """Bands of the positional encoding among the features; 0 for u and v alone."""
    cone_deg: float = 90.0
    """Steepest tilt that a captured ball showed; steeper ones are read by colours that only the
    colour model's extension beyond them tells."""
    error_length_px: float = 0.0
    """Distance over which neighbouring pixels err together (``height_uncertainty``) [px]."""
    height_factor: float = 0.0
    """Factor on the standard deviation of heights that such errors make, found on presses of known
    shape; 0 where nobody looked, and heights then have none."""
    along_factor: float = 0.0
    """Standard deviation, in expected errors of the slope, of an error that lies along the slope
    all around a dent, found on captured balls (``height_uncertainty``)."""
    depth_share: float = 0.0
    """Standard deviation, as a share of the depth, by what the calibration takes as known: circles,
    scale, the gel's law. 0 in profiles that do not say: heights then have the reading's alone."""

    presses_px: tuple[float, ...] = ()
    """Contacts that it was fitted to, each column, row and radius [px]; empty in profiles that do
    not say."""

    def __post_init__(self) -> None:
        if self.width_px < 2 or self.height_px < 2:
            raise InputError(
                f"normal model image size is {self.width_px}x{self.height_px} px; at least 2x2 px"
            )
        if self.members < 1 or any(width < 1 for width in self.hidden):
            raise InputError(
                f"normal model needs members and hidden layers of at least 1, got {self.members} "
                f"and {list(self.hidden)}"
            )
        scales = (*self.scales_px, *self.slope_scales_px)
        if not self.scales_px or not all(0 <= s <= 1e3 for s in scales):
            raise InputError(
                f"normal model scales {list(scales)} px must lie in 0..1000, some given"
            )
        if any(s == 0 for s in self.slope_scales_px):
            raise InputError("normal model slope_scales_px must be above 0 px")
        require_bands("normal model", self.position_bands)
        for name, default in (("input_mean", 0.0), ("input_scale", 1.0)):
            values = getattr(self, name) or (default,) * self.input_count
            if len(values) != self.input_count or not np.isfinite(values).all():
                raise InputError(
                    f"normal model {name} needs {self.input_count} finite numbers, one per "
                    f"feature, got {list(values)}"
                )
            object.__setattr__(self, name, tuple(values))
        if not (0 < self.cone_deg <= 90 and 0 <= self.error_length_px < 1e4):
            raise InputError(
                f"normal model cone_deg must lie in 0..90 and error_length_px in 0..10000, got "
                f"{self.cone_deg:g} and {self.error_length_px:g}"
            )
        for name in ("height_factor", "along_factor", "depth_share"):
            if not 0 <= getattr(self, name) < 1e4:
                raise InputError(
                    f"normal model {name} must lie in 0..10000, got {getattr(self, name):g}"
                )
        if len(self.presses_px) % 3 or not np.isfinite(self.presses_px).all():
            raise InputError(
                "normal model presses_px must hold finite columns, rows and radii, got "
                f"{len(self.presses_px)} numbers"
            )
        factors = (self.error_factor, self.radius95_sigmas)
        if min(self.input_scale) <= 0 or not all(0 < factor < 1e3 for factor in factors):
            raise InputError(
                "normal model input_scale, error_factor and radius95_sigmas must be positive"
            )

    def away(self, every: int = 1) -> np.ndarray:
        """Distance of each pixel from the part of the image that fitted contacts span, in shorter
        sides of it, shape [h, w] of every so many-th row and column; 0 where none is known."""
        spans = []
        for axis, count in enumerate((self.width_px, self.height_px)):
            at = np.arange(0, count, every)
            if self.presses_px:
                middle, radius = np.reshape(self.presses_px, (-1, 3))[:, [axis, 2]].T
                low, high = (middle - radius).min(), (middle + radius).max()
                spans.append(np.maximum(np.maximum(low - at, at - high), 0.0))
            else:
                spans.append(np.zeros(len(at)))
        return np.hypot(spans[0][None, :], spans[1][:, None]) / min(self.width_px, self.height_px)

    @property
    def features(self) -> tuple[str, ...]:
        """Names of the network inputs in order."""
        return feature_names(
            self.scales_px, self.slope_scales_px, self.background, self.position_bands
        )

    @property
    def input_count(self) -> int:
        return len(self.features)

    @property
    def varying_count(self) -> int:
        """Features, the first ones, that are those of a change of colour, not of the place."""
        return 3 * len(self.scales_px) + 6 * len(self.slope_scales_px)

    def layer_sizes(self) -> list[tuple[int, int]]:
        """(outputs, inputs) of each layer of one member."""
        widths = [self.input_count, *self.hidden, OUTPUTS]
        return [(widths[i + 1], widths[i]) for i in range(len(widths) - 1)]

    def to_dict(self) -> dict[str, Any]:
        """Flat dict of numbers and lists, as a profile's ``architecture`` stores it."""
        return settings_dict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> NormalModelConfig:
        """Inverse of ``to_dict``; unknown and missing keys raise InputError."""
        with reading_settings("normal model", cls.__dataclass_fields__, values):
            return cls(
                width_px=int(values["width_px"]),
                height_px=int(values["height_px"]),
                scales_px=tuple(float(s) for s in values["scales_px"]),
                slope_scales_px=tuple(float(s) for s in values["slope_scales_px"]),
                background=bool(values["background"]),
                members=int(values["members"]),
                hidden=tuple(int(width) for width in values["hidden"]),
                input_mean=tuple(float(mean) for mean in values["input_mean"]),
                input_scale=tuple(float(scale) for scale in values["input_scale"]),
                error_factor=float(values["error_factor"]),
                radius95_sigmas=float(values["radius95_sigmas"]),
                position_bands=int(values["position_bands"]),
                cone_deg=float(values["cone_deg"]),
                error_length_px=float(values["error_length_px"]),
                height_factor=float(values["height_factor"]),
                along_factor=float(values["along_factor"]),
                depth_share=float(values["depth_share"]),
                presses_px=tuple(float(x) for x in values["presses_px"]),
            )

    def image_features(
        self,
        change: np.ndarray,
        background: np.ndarray,
        *,
        mask: np.ndarray | None = None,
        zoom: float = 1.0,
        window: tuple[slice, slice] = (slice(None), slice(None)),
        picked: np.ndarray | None = None,
    ) -> np.ndarray:
        """Raw features of every pixel in ``window``, float32, shape [h, w, feature].

        ``change`` and ``background`` [levels] and ``mask`` are of the whole image. With ``picked``,
        pixels counted along the window's rows, those of these alone, shape [n, feature].
        """
        return local_features(
            change[window],
            self.scales_px,
            self.slope_scales_px,
            mask=None if mask is None else mask[window],
            background=background[window] if self.background else None,
            place=pixel_place(self.width_px, self.height_px, self.position_bands)[window],
            zoom=zoom,
            picked=picked,
        )

    def normalise(self, features: np.ndarray) -> np.ndarray:
        """Network inputs of raw features, float32, same shape."""
        mean, scale = (np.array(x, dtype=np.float32) for x in (self.input_mean, self.input_scale))
        return (features - mean) / scale

    def at_rest(self, features: np.ndarray) -> np.ndarray:
        """The raw features of the same pixels without any change of colour, same shape."""
        still = features.copy()
        still[..., : self.varying_count] = 0.0
        return still
