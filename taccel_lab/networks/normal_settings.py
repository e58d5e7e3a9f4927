# SPDX-License-Identifier: Apache-2.0
"""Settings of the networks from colours to normals, and the features that they ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.networks.settings import (
    LEAST_CONE_DEG,
    LEAST_SCALE,
    MAX_BANDS,
    QUESTIONS,
    NetworkSettings,
    band_names,
    forward,
    layer_shapes,
    require_answers,
)

MOST_UNITS = 8.0
"""Largest change of colour: 255 levels, of which a unit has 32."""
_LEAST_WINDOW_PX = 0.1
"""A narrower one is the pixel itself."""
OUTPUTS = 3
"""Two tilts [rad] and the logarithm of the expected angle of error [rad]."""
SMALL_OUTPUTS = OUTPUTS + 1
"""The same of the ensemble, errors with the members' disagreement, and the logarithm of the angle
that the small network is expected to be off the ensemble [rad]."""
SMALL = "small."
"""Beginning of the names of the small network's weights."""
RAYLEIGH_95 = math.sqrt(-2.0 * math.log(0.05))
"""Length that 95 % of vectors of two independent normal deviates of unit standard deviation stay
below."""


@dataclass(frozen=True)
class NormalModelConfig(NetworkSettings):
    """Everything besides the weights that is needed to rebuild a ``NormalModel``."""

    model: ClassVar[str] = "normal model"

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
    """Distance over which neighbouring pixels err together (``read_heights``) [px]."""
    height_factor: float = 0.0
    """Factor on the standard deviation of heights that such errors make, found on presses of known
    shape; 0 where nobody looked, and heights then have none."""
    along_factor: float = 0.0
    """Standard deviation, in expected errors of the slope, of an error that lies along the slope
    all around a dent, found on captured balls (``read_heights``)."""
    depth_share: float = 0.0
    """Standard deviation, as a share of the depth, by what the calibration takes as known: circles,
    scale, the gel's law. 0 in profiles that do not say: heights then have the reading's alone."""

    presses_px: tuple[float, ...] = ()
    """Contacts that it was fitted to, each column, row and radius [px]; empty in profiles that do
    not say."""
    unit_share: float = 0.0
    """Standard deviation of slopes, as a share of the tilt, and of the depths that they add up to,
    by what the captures do not tell: of another unit of the sensor, or of a ball whose radius may
    be its diameter; 0 where they do."""
    small_hidden: tuple[int, ...] = ()
    """Widths of the hidden layers of the small network that reads for the ensemble what it reads as
    well (``small_network``); empty where the ensemble reads all."""

    def __post_init__(self) -> None:
        if self.width_px < 2 or self.height_px < 2:
            raise InputError(
                f"normal model image size is {self.width_px}x{self.height_px} px; at least 2x2 px"
            )
        if self.members < 1 or min((*self.hidden, *self.small_hidden), default=1) < 1:
            raise InputError(
                f"normal model needs members and hidden layers of at least 1, got {self.members}, "
                f"{list(self.hidden)} and {list(self.small_hidden)}"
            )
        largest = max(self.width_px, self.height_px)
        if not self.scales_px:
            raise InputError("normal model scales_px must hold some windows")
        for name, least in (("scales_px", 0.0), ("slope_scales_px", _LEAST_WINDOW_PX)):
            for scale in getattr(self, name):
                if scale or least:  # 0 is the pixel itself.
                    require_range(f"normal model {name}", scale, _LEAST_WINDOW_PX, largest)
        require_range("normal model position_bands", self.position_bands, 0, MAX_BANDS)
        for name, default in (("input_mean", 0.0), ("input_scale", 1.0)):
            values = getattr(self, name) or (default,) * self.input_count
            if len(values) != self.input_count:
                raise InputError(
                    f"normal model {name} needs {self.input_count} numbers, one per feature, got "
                    f"{list(values)}"
                )
            object.__setattr__(self, name, tuple(values))
        for k, name in enumerate(self.features):
            of_color = k < self.varying_count or name.startswith("background")
            reach = MOST_UNITS if of_color else 1.0
            mean, scale = self.input_mean[k], self.input_scale[k]
            require_range(f"normal model input_mean of {name}", mean, -reach, reach)
            require_range(f"normal model input_scale of {name}", scale, LEAST_SCALE, 2 * reach)
        for name, low, high in (
            ("cone_deg", LEAST_CONE_DEG, 90.0),
            ("error_length_px", 0.0, largest),
            ("height_factor", 0.0, 100.0),
            ("along_factor", 0.0, 100.0),
            ("depth_share", 0.0, 2.0),
            ("unit_share", 0.0, 2.0),
            ("error_factor", 0.02, 50.0),
            ("radius95_sigmas", 1.0, 100.0),
            ("presses_px", -largest, 2 * largest),
        ):
            require_range(f"normal model {name}", getattr(self, name), low, high)
        if len(self.presses_px) % 3 or min(self.presses_px[2::3], default=0.0) < 0:
            raise InputError(
                "normal model presses_px must hold columns, rows and radii, got "
                f"{len(self.presses_px)} numbers"
            )

    def away(self, block_px: int = 1) -> np.ndarray:
        """Distance of each pixel, or of the middle of each block of them, from the part of the
        image that fitted contacts span, in its shorter sides, [h, w]; 0 where none is known."""
        spans = []
        for axis, count in enumerate((self.width_px, self.height_px)):
            at = np.arange(0, count, block_px) + 0.5 * (block_px - 1)
            if self.presses_px:
                middle, radius = np.reshape(self.presses_px, (-1, 3))[:, [axis, 2]].T
                low, high = (middle - radius).min(), (middle + radius).max()
                spans.append(np.maximum(np.maximum(low - at, at - high), 0.0))
            else:
                spans.append(np.zeros(len(at)))
        return np.hypot(spans[0][None, :], spans[1][:, None]) / min(self.width_px, self.height_px)

    @property
    def blur_px(self) -> float:
        """Standard deviation that the outline of a contact may be off by: half of the distance over
        which pixels err together. Real flat faces are read up to this much too wide."""
        return 0.5 * self.error_length_px

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

    def weight_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each weight array by name: the layers of the ensemble in their order, then those
        of the small network, if there is one."""
        shapes = layer_shapes(self._sizes(self.hidden, OUTPUTS), (self.members,))
        if self.small_hidden:
            small = layer_shapes(self._sizes(self.small_hidden, SMALL_OUTPUTS))
            shapes |= {SMALL + name: shape for name, shape in small.items()}
        return shapes

    def _sizes(self, hidden: tuple[int, ...], outputs: int) -> list[tuple[int, int]]:
        """(outputs, inputs) of each layer of one network."""
        widths = [self.input_count, *hidden, outputs]
        return [(widths[i + 1], widths[i]) for i in range(len(widths) - 1)]

    def normalise(self, features: np.ndarray) -> np.ndarray:
        """Network inputs of raw features, float32, same shape."""
        mean, scale = (np.array(x, dtype=np.float32) for x in (self.input_mean, self.input_scale))
        return (features - mean) / scale

    def at_rest(self, features: np.ndarray) -> np.ndarray:
        """The raw features of the same pixels without any change of colour, same shape."""
        still = features.copy()
        still[..., : self.varying_count] = 0.0
        return still


def feature_names(
    scales_px: Sequence[float],
    slope_scales_px: Sequence[float],
    background: bool,
    position_bands: int = 0,
) -> tuple[str, ...]:
    """Names of the features in order."""
    names = [f"change_{c}_{s:g}px" for s in scales_px for c in "rgb"]
    names += [f"d{axis}_{c}_{s:g}px" for s in slope_scales_px for axis in "uv" for c in "rgb"]
    if background:
        names += [f"background_{c}" for c in "rgb"]
    return (*names, "u", "v", *band_names(position_bands))


def ensemble_of(weights: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Weights of the ensemble alone, by the names of its layers."""
    return {name: values for name, values in weights.items() if not name.startswith(SMALL)}


def small_of(weights: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Weights of the small network, by the names of its layers; empty where there is none."""
    return {
        name.removeprefix(SMALL): values
        for name, values in weights.items()
        if name.startswith(SMALL)
    }


def require_angles(config: NormalModelConfig, weights: Mapping[str, np.ndarray]) -> None:
    """Refuse networks whose tilts are no angles, over twice the spread of their features."""
    spread = np.random.default_rng(0).uniform(-2, 2, (QUESTIONS, config.input_count))
    raw = np.array(config.input_mean) + np.array(config.input_scale) * spread
    inputs = config.normalise(raw), config.normalise(config.at_rest(raw))
    small = small_of(weights)
    for what, network in (("", ensemble_of(weights)), ("'s small network", small)):
        if network:
            read, still = (forward(network, values, "silu")[..., :2] for values in inputs)
            off = (read - still).reshape(-1, *read.shape[-2:]).mean(axis=0)
            sizes = np.degrees(np.linalg.norm(off, axis=-1))
            who = f"the normal model{what}"
            require_answers(who, sizes, 0.1, 360.0, "degrees", "a tilt has up to 90")
