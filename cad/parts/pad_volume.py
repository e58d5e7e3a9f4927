# SPDX-License-Identifier: Apache-2.0
"""Volume of a pad by its own formula, which the mesh and the CAD solid have to meet."""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.parts.pad import Pad

_GRID = 200


def plan_points_mm(pad: Pad) -> np.ndarray:
    """Middles of equal cells of the pad's plan [mm], shape [200, 200, 2]."""
    low, high = pad.bounds_mm()
    steps = (np.arange(_GRID) + 0.5) / _GRID
    axes = [low[k] + steps * (high[k] - low[k]) for k in range(2)]
    return np.stack(np.meshgrid(*axes), axis=-1)


def pad_volume_mm3(pad: Pad) -> float:
    """Volume of the gel [mm^3]: the pad's own figure, or the midpoint rule over its height map."""
    stated = pad.figures().get("volume_mm3")
    if stated is not None:
        return float(stated)
    low, high = pad.bounds_mm()
    height = pad.top_mm(plan_points_mm(pad)) - low[2]
    cell = (high - low)[:2].prod() / _GRID**2
    return float(np.nansum(height) * cell)
