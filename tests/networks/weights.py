# SPDX-License-Identifier: Apache-2.0
"""Networks of random weights, small ones of each kind among them."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.force_settings import ForceModelConfig
from taccel_lab.networks.normal_settings import NormalModelConfig

COLOR = ColorModelConfig(40, 30, hidden=(16, 8))
NORMAL = NormalModelConfig(40, 30, members=3, hidden=(16, 8))
FORCE = ForceModelConfig(40, 30, columns=4, rows=3, patch_px=4, widths=(3, 5), blocks=2, hidden=6)


def random_weights(config: Any, seed: int = 0, spread: float | None = None) -> dict[str, Any]:
    """Of one standard deviation, or one over the square root of a neuron's inputs."""
    rng = np.random.default_rng(seed)
    return {
        name: rng.normal(0, spread or shape[-1] ** -0.5, shape).astype(np.float32)
        for name, shape in config.weight_shapes().items()
    }
