# SPDX-License-Identifier: Apache-2.0
"""Settings of the network from a pixel's place and surface normal to its change of colour, its
inputs, and whether its answers exist (``signals.color_model`` runs it)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.networks.settings import (
    ACTIVATIONS,
    LEAST_CONE_DEG,
    LEAST_SCALE,
    MAX_BANDS,
    QUESTIONS,
    NetworkSettings,
    encode_position,
    forward,
    layer_shapes,
    require_answers,
)

INPUT_NAMES = ("u", "v", "normal_x", "normal_y", "normal_z", "displacement_mm")
_MOST_DISPLACEMENT_MM = 50.0
"""Half of the thickest gel."""
UPRIGHT_DEG = 90.0
"""A cone that holds every normal."""
STEEPEST = "surface_tilt_deg"
"""Entry of a block's ``valid_region``: tilts of the surfaces that it was fitted to [deg]."""


@dataclass(frozen=True)
class ColorModelConfig(NetworkSettings):
    """Everything besides the weights that is needed to rebuild a ``ColorModel``."""

    model: ClassVar[str] = "color model"

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
            if len(values) != len(self.inputs):
                raise InputError(
                    f"color model {name} needs {len(self.inputs)} numbers, one per input, got "
                    f"{list(values)}"
                )
        for name, mean, scale in zip(self.inputs, self.input_mean, self.input_scale, strict=True):
            reach = _MOST_DISPLACEMENT_MM if name == "displacement_mm" else 1.0
            low = 0.0 if name == "normal_z" else -reach
            require_range(f"color model input_mean of {name}", mean, low, reach)
            require_range(f"color model input_scale of {name}", scale, LEAST_SCALE, 2 * reach)
        require_range("color model output_scale", self.output_scale, 0.01, 1e4)
        require_range("color model position_bands", self.position_bands, 0, MAX_BANDS)

    @property
    def input_count(self) -> int:
        """Inputs of the network, those of the positional encoding among them."""
        return len(self.inputs) + 4 * self.position_bands

    def layer_sizes(self) -> list[tuple[int, int]]:
        """(outputs, inputs) of each layer."""
        widths = [self.input_count, *self.hidden, 3]
        return [(widths[i + 1], widths[i]) for i in range(len(widths) - 1)]

    def weight_shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every weight array."""
        return layer_shapes(self.layer_sizes())


def fitted_cone_deg(valid_region: Mapping[str, tuple[float, float]]) -> float:
    """Tilt of the steepest normal that a block with this ``valid_region`` was fitted to [deg]."""
    return min(valid_region.get(STEEPEST, (0.0, UPRIGHT_DEG))[1], UPRIGHT_DEG)


def require_cone(cone_deg: float) -> None:
    """Refuse a tilt that no normal of a surface has."""
    require_range(f"color model {STEEPEST}", cone_deg, LEAST_CONE_DEG, UPRIGHT_DEG)


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


def require_levels(
    config: ColorModelConfig, weights: Mapping[str, np.ndarray], cone_deg: float
) -> None:
    """Refuse a network whose changes of colour no picture holds or shows, over the tilts that it
    was fitted to, up to ``cone_deg``, and twice the spread of its displacements."""
    rng = np.random.default_rng(0)
    tilt = np.radians(rng.uniform(0, min(cone_deg, 60.0), QUESTIONS))
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
        forward(weights, stack_inputs(config, uv, n, d), config.activation)
        for n, d in ((normals, depth_mm), (upright, np.zeros(QUESTIONS)))
    )
    sizes = config.output_scale * np.abs(pressed - at_rest).max(axis=-1)
    require_answers("the color model", sizes, 0.5, 2 * 255.0, "levels", "a picture holds 255")
