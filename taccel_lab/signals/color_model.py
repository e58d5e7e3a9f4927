# SPDX-License-Identifier: Apache-2.0
"""Tactile image from the gel's surface: a small network gives the colour change of each pixel.

The network maps pixel position, surface normal and the rise of the surface over its rest position
to an RGB change; the change it gives for the undeformed surface at the same pixel is subtracted,
so that untouched gel renders as the background, exactly. Position and normal are the inputs of
Taxim (Si and Yuan, RA-L 2022) and FOTS (Zhao et al., RA-L 2024); the displacement tells the floor
of a dent from untouched gel, which has the same normal but lies closer to the lamps. The position
may be given as sines and cosines, too (``position_encoding``).

Beyond the steepest surface that balls showed, the network would answer whatever it likes. A normal
that leans further is answered as if it leaned that far, the same way (``within_cone``).

The weights are plain numpy arrays and the settings a flat dict, which is what a sensor profile
stores; torch is imported when an image is rendered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.signals.model_settings import (
    reading_settings,
    require_camera_size,
    settings_dict,
)
from taccel_lab.signals.network_answers import QUESTIONS, forward, require_answers
from taccel_lab.signals.position_encoding import encode_position, require_bands

if TYPE_CHECKING:
    import torch

    from taccel_lab.profile import SensorProfile

INPUT_NAMES = ("u", "v", "normal_x", "normal_y", "normal_z", "displacement_mm")
ACTIVATIONS = ("silu", "tanh", "relu")
CHUNK_PIXELS = 2048
"""Read at once: what the layers give for so many stays in a core's cache."""
UPRIGHT_DEG = 90.0
"""A cone that holds every normal."""
STEEPEST = "surface_tilt_deg"
"""Entry of a block's ``valid_region``: tilts of the surfaces that it was fitted to [deg]."""


@dataclass(frozen=True)
class ColorModelConfig:
    """Everything besides the weights that is needed to rebuild a ``ColorModel``."""

    width_px: int
    height_px: int
    inputs: tuple[str, ...] = INPUT_NAMES
    """Network inputs in order, names from ``INPUT_NAMES``; u and v run over -1..1."""
    hidden: tuple[int, ...] = (64, 64, 64)
    """Widths of the hidden layers."""
    activation: str = "silu"
    input_mean: tuple[float, ...] = (0.0,) * len(INPUT_NAMES)
    """Subtracted from each input."""
    input_scale: tuple[float, ...] = (1.0,) * len(INPUT_NAMES)
    """Divides each input after that."""
    output_scale: float = 32.0
    """Levels (of 255) per unit of network output."""
    position_bands: int = 0
    """Bands of the positional encoding, whose sines and cosines follow ``inputs`` as they are; 0
    for u and v alone."""

    def __post_init__(self) -> None:
        unknown = [name for name in self.inputs if name not in INPUT_NAMES]
        if unknown or not self.inputs:
            raise InputError(
                f"color model inputs {list(self.inputs)} are not allowed; some of "
                f"{', '.join(INPUT_NAMES)}"
            )
        if self.activation not in ACTIVATIONS:
            raise InputError(
                f"color model activation {self.activation!r} is not one of {', '.join(ACTIVATIONS)}"
            )
        if self.width_px < 2 or self.height_px < 2:
            raise InputError(
                f"color model image size is {self.width_px}x{self.height_px} px; at least 2x2 px"
            )
        if any(width < 1 for width in self.hidden):
            raise InputError(f"color model hidden layers {list(self.hidden)} must be at least 1")
        for name in ("input_mean", "input_scale"):
            values = getattr(self, name)
            if len(values) != len(self.inputs) or not np.isfinite(values).all():
                raise InputError(
                    f"color model {name} needs {len(self.inputs)} finite numbers, one per input, "
                    f"got {list(values)}"
                )
        if min(self.input_scale) <= 0 or not self.output_scale > 0:
            raise InputError("color model input_scale and output_scale must be positive")
        require_bands("color model", self.position_bands)

    @property
    def input_count(self) -> int:
        """Inputs of the network, those of the positional encoding among them."""
        return len(self.inputs) + 4 * self.position_bands

    def layer_sizes(self) -> list[tuple[int, int]]:
        """(outputs, inputs) of each layer."""
        widths = [self.input_count, *self.hidden, 3]
        return [(widths[i + 1], widths[i]) for i in range(len(widths) - 1)]

    def to_dict(self) -> dict[str, Any]:
        """Flat dict of numbers, strings and lists, as a profile's ``architecture`` stores it."""
        return settings_dict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ColorModelConfig:
        """Inverse of ``to_dict``; unknown and missing keys raise InputError."""
        with reading_settings("color model", cls.__dataclass_fields__, values):
            return cls(
                width_px=int(values["width_px"]),
                height_px=int(values["height_px"]),
                inputs=tuple(str(name) for name in values["inputs"]),
                hidden=tuple(int(width) for width in values["hidden"]),
                activation=str(values["activation"]),
                input_mean=tuple(float(mean) for mean in values["input_mean"]),
                input_scale=tuple(float(scale) for scale in values["input_scale"]),
                output_scale=float(values["output_scale"]),
                position_bands=int(values["position_bands"]),
            )


class ColorModel:
    """Colour change of tactile pixels.

    ``weights`` holds float32 arrays ``layer<i>.weight`` [outputs, inputs] and ``layer<i>.bias``
    [outputs]; ``cone_deg`` is the tilt of the steepest normal that it was fitted to.
    """

    def __init__(
        self,
        config: ColorModelConfig,
        weights: Mapping[str, np.ndarray],
        cone_deg: float = UPRIGHT_DEG,
    ) -> None:
        if not 0 < cone_deg <= UPRIGHT_DEG:
            raise InputError(f"color model cone_deg must lie in 0..90, got {cone_deg:g}")
        self.config = config
        self.cone_deg = cone_deg
        self.weights = {
            name: np.array(value, dtype=np.float32, order="C") for name, value in weights.items()
        }
        expected = expected_shapes(config)
        found = {name: value.shape for name, value in self.weights.items()}
        if found != expected:
            raise InputError(f"color model weights have shapes {found}, expected {expected}")
        if not all(np.isfinite(value).all() for value in self.weights.values()):
            raise InputError("color model weights hold NaN or infinite values")

    @classmethod
    def from_profile(cls, profile: SensorProfile) -> ColorModel | None:
        """The colour model of a profile's sensor; None when it has none.

        Its cone is the ``surface_tilt_deg`` of the block's ``valid_region``. Raises InputError when
        it is for images of another size than those of the camera, or changes colours by more than
        a picture holds.
        """
        if profile.color is None or profile.color_weights is None:
            return None
        config = ColorModelConfig.from_dict(profile.color.architecture)
        require_camera_size(profile, "color", config.width_px, config.height_px)
        region = profile.color.provenance.valid_region
        steepest_deg = region.get(STEEPEST, (0.0, UPRIGHT_DEG))[1]
        model = cls(config, profile.color_weights, min(steepest_deg, UPRIGHT_DEG))
        model.require_levels()
        return model

    def require_levels(self) -> None:
        """Refuse a network whose changes of colour no picture holds, over the tilts that it was
        fitted to and twice the spread of its displacements."""
        rng, config = np.random.default_rng(0), self.config
        tilt = np.radians(rng.uniform(0, min(self.cone_deg, 60.0), QUESTIONS))
        turn = rng.uniform(0, 2 * np.pi, QUESTIONS)
        across = np.sin(tilt)
        normals = np.stack([across * np.cos(turn), across * np.sin(turn), np.cos(tilt)], axis=-1)
        depth_mm = np.zeros(QUESTIONS)
        if "displacement_mm" in config.inputs:
            place = config.inputs.index("displacement_mm")
            spread = rng.uniform(-2, 2, QUESTIONS)
            depth_mm = config.input_mean[place] + config.input_scale[place] * spread
        uv = pixel_uv(config, rng.integers(config.width_px * config.height_px, size=QUESTIONS))
        upright = np.tile([0.0, 0.0, 1.0], (QUESTIONS, 1))
        pressed, at_rest = (
            forward(self.weights, stack_inputs(config, uv, n, d), config.activation)
            for n, d in ((normals, depth_mm), (upright, np.zeros(QUESTIONS)))
        )
        sizes = config.output_scale * np.abs(pressed - at_rest).max(axis=-1)
        require_answers("the color model", sizes, 2 * 255.0, "levels", "a picture holds 255")

    def predict_pixels(
        self,
        pixel_idx: np.ndarray,
        normals: np.ndarray,
        displacement_mm: np.ndarray,
        rest_normals: np.ndarray,
    ) -> np.ndarray:
        """Colour change [levels of 255] of single pixels, float32, shape [n, 3].

        ``pixel_idx`` counts along rows, shape [n]; ``normals`` and ``rest_normals`` have shape
        [n, 3], ``displacement_mm`` [n].
        """
        still = np.zeros(len(pixel_idx))
        pressed = self.network_levels(pixel_idx, normals, displacement_mm)
        return pressed - self.network_levels(pixel_idx, rest_normals, still)

    def network_levels(
        self, pixel_idx: np.ndarray, normals: np.ndarray, displacement_mm: np.ndarray
    ) -> np.ndarray:
        """What the network gives for pixels [levels], float32, shape [n, 3]; a change of colour is
        the difference to the same pixels at rest. Arguments as of ``predict_pixels``."""
        import torch

        levels = np.empty((len(pixel_idx), 3), dtype=np.float32)
        normals = within_cone(normals, self.cone_deg)
        layers = layer_tensors(self.config, self.weights)
        with torch.inference_mode():
            for start in range(0, len(pixel_idx), CHUNK_PIXELS):
                part = slice(start, start + CHUNK_PIXELS)
                uv = pixel_uv(self.config, pixel_idx[part])
                inputs = stack_inputs(self.config, uv, normals[part], displacement_mm[part])
                levels[part] = _network(self.config, layers, torch.from_numpy(inputs)).numpy()
        return levels


def within_cone(normals: np.ndarray, cone_deg: float) -> np.ndarray:
    """Unit normals, shape [n, 3], that lean by more than ``cone_deg`` turned back to that tilt."""
    if cone_deg >= UPRIGHT_DEG:
        return normals
    cone = math.radians(cone_deg)
    across = np.hypot(normals[:, 0], normals[:, 1])
    share = np.minimum(1.0, math.sin(cone) / np.maximum(across, 1e-30))
    up = np.maximum(normals[:, 2], math.cos(cone))
    return np.stack([share * normals[:, 0], share * normals[:, 1], up], axis=-1)


def expected_shapes(config: ColorModelConfig) -> dict[str, tuple[int, ...]]:
    """Name and shape of every weight array."""
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (outputs, inputs) in enumerate(config.layer_sizes()):
        shapes[f"layer{i}.weight"] = (outputs, inputs)
        shapes[f"layer{i}.bias"] = (outputs,)
    return shapes


def pixel_uv(config: ColorModelConfig, pixel_idx: np.ndarray) -> np.ndarray:
    """Normalised (u, v) of flat pixel indices, -1..1 over the image, shape [n, 2]."""
    column = pixel_idx % config.width_px
    row = pixel_idx // config.width_px
    return np.stack(
        [2 * column / (config.width_px - 1) - 1, 2 * row / (config.height_px - 1) - 1], axis=-1
    )


def stack_inputs(
    config: ColorModelConfig, uv: np.ndarray, normals: np.ndarray, displacement_mm: np.ndarray
) -> np.ndarray:
    """Normalised network inputs, float32, shape [n, input_count]; arguments have n rows."""
    columns = {
        "u": uv[:, 0],
        "v": uv[:, 1],
        "normal_x": normals[:, 0],
        "normal_y": normals[:, 1],
        "normal_z": normals[:, 2],
        "displacement_mm": displacement_mm,
    }
    stacked = np.stack([columns[name] for name in config.inputs], axis=-1)
    stacked = (stacked - np.array(config.input_mean)) / np.array(config.input_scale)
    if config.position_bands:
        stacked = np.concatenate([stacked, encode_position(uv, config.position_bands)], axis=-1)
    return stacked.astype(np.float32)


def layer_tensors(
    config: ColorModelConfig, weights: Mapping[str, np.ndarray]
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """(weight, bias) of each layer as torch tensors."""
    import torch

    return [
        (torch.from_numpy(weights[f"layer{i}.weight"]), torch.from_numpy(weights[f"layer{i}.bias"]))
        for i in range(len(config.layer_sizes()))
    ]


def color_change(
    config: ColorModelConfig,
    layers: Sequence[tuple[torch.Tensor, torch.Tensor]],
    pressed: torch.Tensor,
    at_rest: torch.Tensor,
) -> torch.Tensor:
    """Change in levels of 255 between two sets of network inputs, shape [n, 3]; differentiable."""
    import torch

    both = _network(config, layers, torch.cat([pressed, at_rest]))
    return both[: len(pressed)] - both[len(pressed) :]


def _network(
    config: ColorModelConfig,
    layers: Sequence[tuple[torch.Tensor, torch.Tensor]],
    inputs: torch.Tensor,
) -> torch.Tensor:
    """Outputs [levels] of network inputs, shape [n, 3]; differentiable."""
    import torch

    values = inputs
    activation = getattr(torch.nn.functional, config.activation)
    for weight, bias in layers[:-1]:
        values = activation(torch.nn.functional.linear(values, weight, bias))
    # The last bias cancels in the difference; it is kept so that the layers are ordinary ones.
    last_weight, last_bias = layers[-1]
    return torch.nn.functional.linear(values, last_weight, last_bias) * config.output_scale
