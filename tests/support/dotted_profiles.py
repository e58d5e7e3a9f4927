# SPDX-License-Identifier: Apache-2.0
"""Sensors whose picture shows their dots and nothing else: no press changes their colours."""

from __future__ import annotations

import numpy as np

from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import BackgroundBlock, ColorBlock, Provenance, SensorProfile

LIGHT, DARK = 150, 30
"""Levels of the picture beside its dots and in them."""
SAID = Provenance(kind="assumed", method="made up for a test", source="none")


def with_painted_dots(
    profile: SensorProfile, places_px: np.ndarray, radius_px: float
) -> SensorProfile:
    """The profile with dark dots at places [n, 2] of its picture."""
    grid = profile.grid()
    v, u = np.mgrid[: grid.height_px, : grid.width_px]
    image = np.full((*u.shape, 3), LIGHT, np.float32)
    for place in places_px:
        image[np.hypot(u - place[0], v - place[1]) <= radius_px] = DARK
    config = ColorModelConfig(grid.width_px, grid.height_px, hidden=(8, 8))
    still = {name: np.zeros(shape, np.float32) for name, shape in config.weight_shapes().items()}
    profile = profile.with_block(BackgroundBlock(provenance=SAID), image)
    return profile.with_block(ColorBlock(architecture=config.to_dict(), provenance=SAID), still)
