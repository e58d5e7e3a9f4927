# SPDX-License-Identifier: Apache-2.0
"""Tactile image from the gel's surface: a small network gives the colour change of each pixel.

The network maps pixel position, surface normal and the rise of the surface over its rest position
to an RGB change; the change it gives for the undeformed surface at the same pixel is subtracted,
so that untouched gel renders as the background, exactly. Position and normal are the inputs of
Taxim (Si and Yuan, RA-L 2022) and FOTS (Zhao et al., RA-L 2024); the displacement tells the floor
of a dent from untouched gel, which has the same normal but lies closer to the lamps. The position
may be given as sines and cosines, too (``networks.settings``).

Beyond the steepest surface that balls showed, the network would answer whatever it likes. A normal
that leans further is answered as if it leaned that far, the same way (``within_cone``).

The weights are plain numpy arrays and the settings a flat dict, which is what a sensor profile
stores; torch is imported when an image is rendered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.networks.color_settings import (
    UPRIGHT_DEG,
    ColorModelConfig,
    fitted_cone_deg,
    pixel_uv,
    require_cone,
    stack_inputs,
)
from taccel_lab.networks.settings import checked_weights
from taccel_lab.signals.tensors import layer_tensors

if TYPE_CHECKING:
    import torch

    from taccel_lab.profile import SensorProfile

CHUNK_PIXELS = 2048
"""Pixels read at once: what the layers give for them stays in a core's cache."""


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
        require_cone(cone_deg)
        self.config = config
        self.cone_deg = cone_deg
        self.weights = checked_weights("color model", config.weight_shapes(), weights)

    @classmethod
    def from_profile(cls, profile: SensorProfile) -> ColorModel | None:
        """The colour model of a profile's sensor; None when it has none."""
        if profile.color is None or profile.color_weights is None:
            return None
        config = ColorModelConfig.from_dict(profile.color.architecture)
        cone_deg = fitted_cone_deg(profile.color.provenance.valid_region)
        return cls(config, profile.color_weights, cone_deg)

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
        layers = layer_tensors(self.weights)
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


def color_change(
    config: ColorModelConfig,
    layers: Sequence[tuple[torch.Tensor, torch.Tensor]],
    pressed: torch.Tensor,
    at_rest: torch.Tensor,
) -> torch.Tensor:
    """Change in levels of 255 between two sets of network inputs, shape [n, 3]; differentiable."""
    import torch

    both = _network(config, layers, torch.cat([pressed, at_rest]))
    count = pressed.shape[0]
    return both[:count] - both[count:]


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
