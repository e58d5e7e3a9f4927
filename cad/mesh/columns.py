# SPDX-License-Identifier: Apache-2.0
"""What all column meshes share: heights of their levels, and the checks of a finished mesh."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.errors import InputError


class FoldedMeshError(InputError):
    """A structured mesh that folds over itself."""


def level_fractions(layers: int, ratio: np.ndarray) -> np.ndarray:
    """Height of each level over the back as a fraction, 0 to 1, shape [layers + 1, ...].

    The layer at the contact face is the thinnest; each one below is ``ratio`` [...] times as thick.
    """
    ratio = np.asarray(ratio, dtype=np.float64)
    thickness = np.stack([ratio**k for k in range(layers - 1, -1, -1)])
    below = np.concatenate([np.zeros((1, *ratio.shape)), np.cumsum(thickness, axis=0)])
    fraction = below / below[-1]
    return fraction


def growth_factor(first: float, count: int) -> float:
    """Factor, at least 1, by which ``count`` steps grow from ``first`` on so that they fill 1."""
    low, high = 1.0, 2 / first
    while high - low > 1e-12 * high:
        factor = 0.5 * (low + high)
        filled = first * (factor ** np.arange(count)).sum()
        low, high = (low, factor) if filled > 1 else (factor, high)
    return low


def check_unfolded(
    nodes_mm: np.ndarray,
    tets: np.ndarray,
    *,
    remedy: str = "with a focus, move it away from the edge or make focus_radius_mm or spread "
    "smaller; without one, make the window smaller",
) -> None:
    """Raise FoldedMeshError with the place and the remedy where tets are flat or inside out."""
    p = nodes_mm[tets]
    volume = np.linalg.det(p[:, 1:] - p[:, :1]) / 6
    if (volume <= 0).any():
        x, y, z = p[int(volume.argmin())].mean(axis=0)
        raise FoldedMeshError(
            f"{int((volume <= 0).sum())} of {len(tets)} tets of the structured mesh fold over, the "
            f"worst at x {x:.2f}, y {y:.2f}, z {z:.2f} mm; {remedy}"
        )


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise InputError with the allowed values unless low <= value <= high."""
    if not (math.isfinite(value) and low <= value <= high):
        raise InputError(f"{name} = {value!r} is not allowed; use {low:g} to {high:g}")
