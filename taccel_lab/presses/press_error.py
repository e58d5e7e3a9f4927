# SPDX-License-Identifier: Apache-2.0
"""The numerical error that presses of a grade keep to in 19 of 20 cases.

Mesh, contact range ``dhat`` and steps part a press from the exact solution of its equations.
``measured_press`` measures them for one press; batches and previews take what a battery of presses
says of their grade (docs/verification.md, Presses by default).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from taccel_lab.presses.physics import PHYSICS, Accuracy
from taccel_lab.scene import Ball, Element, TriangleMesh

if TYPE_CHECKING:
    from taccel_lab.presses.physics import PressPhysics


class Shares(NamedTuple):
    """Of smooth tools, and of tools that may have rims."""

    smooth: float
    rims: float

    def of(self, shape: Ball | TriangleMesh) -> float:
        """That of a tool."""
        return self.smooth if isinstance(shape, Ball) else self.rims


FORCE_SHARE = {
    Accuracy.FAST: Shares(0.034, 0.11),
    Accuracy.DEFAULT: Shares(0.034, 0.055),
    Accuracy.REFERENCE: Shares(0.01, 0.02),
}
"""Error over the force."""
HEIGHT_SHARE = {
    Accuracy.FAST: Shares(0.0095, 0.057),
    Accuracy.DEFAULT: Shares(0.0036, 0.0135),
    Accuracy.REFERENCE: Shares(0.001, 0.005),
}
"""Root mean square error of the heights over the depth."""
LINEAR_SHARE = 0.6
"""Of the force by linear elements on the default mesh; of first order in the elements' size."""


@dataclass(frozen=True)
class PressError:
    """Numerical error of presses."""

    force_n: np.ndarray
    """Of the force along the press [N], shape [env_count]."""
    height_m: np.ndarray
    """Of the heights of the contact face, root mean square [m], shape [env_count]."""


def expected_error(
    physics: PressPhysics,
    shape: Ball | TriangleMesh,
    force_n: np.ndarray,
    depth_m: np.ndarray,
) -> PressError:
    """What presses of a grade keep to in 19 of 20 cases, on meshes made for the press.

    Args:
        physics: Grade and element; with a coarser mesh or a larger contact range than the grade's
            nobody has measured what presses keep to, and errors are NaN.
        shape: What presses.
        force_n: Along the press [N], [env_count].
        depth_m: Past first touch [m], [env_count].
    """
    force_n, depth_m = np.abs(force_n), np.maximum(depth_m, 0.0)
    if physics.element is Element.LINEAR:
        finer = (_cells(physics, shape) / _cells(PHYSICS[Accuracy.DEFAULT], shape)) ** (1 / 3)
        share = LINEAR_SHARE / finer
    else:
        usual = PHYSICS[physics.accuracy]
        coarser = _cells(physics, shape) < _cells(usual, shape) or physics.dhat_m > usual.dhat_m
        share = math.nan if coarser else FORCE_SHARE[physics.accuracy].of(shape)
    heights = HEIGHT_SHARE[physics.accuracy].of(shape)
    return PressError(share * force_n, (math.nan if math.isnan(share) else heights) * depth_m)


def _cells(physics: PressPhysics, shape: Ball | TriangleMesh) -> int:
    mesh = physics.mesh
    return mesh.cell_count if isinstance(shape, Ball) else mesh.outline.cell_count
