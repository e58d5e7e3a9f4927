# SPDX-License-Identifier: Apache-2.0
"""The numerical error that presses of a grade keep to in 19 of 20 cases.

Mesh, contact range ``dhat`` and steps part a press from the exact solution of its equations.
``measured_press`` measures them for one press; batches and previews take what a battery of presses
says of their grade (docs/evidence/verification.md, Presses by default).
"""

from __future__ import annotations

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
COARSE_ORDER = 5
"""How errors grow on meshes coarser than the grade's, by elements along a side."""
GAP_SHARE = 0.06
"""Of the force, by what ``dhat`` is larger than the grade's, over the depth."""
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
        physics: Grade and element; a coarser mesh or a larger contact range add to it.
        shape: What presses.
        force_n: Along the press [N], [env_count].
        depth_m: Past first touch [m], [env_count].
    """
    depth_m = np.maximum(depth_m, 0.0)
    linear, usual = physics.element is Element.LINEAR, PHYSICS[physics.accuracy]
    rule = PHYSICS[Accuracy.DEFAULT] if linear else usual
    finer = (_cells(physics, shape) / _cells(rule, shape)) ** (1 / 3)
    coarser = min(finer, 1.0) ** -COARSE_ORDER
    share = LINEAR_SHARE / finer if linear else coarser * FORCE_SHARE[physics.accuracy].of(shape)
    wider_m = max(physics.dhat_m - usual.dhat_m, 0.0)
    gap = GAP_SHARE * wider_m / np.maximum(depth_m, physics.dhat_m)
    heights = coarser * HEIGHT_SHARE[physics.accuracy].of(shape)
    return PressError((share + gap) * np.abs(force_n), heights * depth_m)


def _cells(physics: PressPhysics, shape: Ball | TriangleMesh) -> int:
    mesh = physics.mesh
    return mesh.cell_count if isinstance(shape, Ball) else mesh.outline.cell_count
