# SPDX-License-Identifier: Apache-2.0
"""How a material is fitted, checked."""

from __future__ import annotations

from dataclasses import dataclass, field

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressPhysics

FIXABLE = ("e", "nu", "mooney_ratio", "friction")
"""Parameters that a user may hold."""


@dataclass(frozen=True)
class MaterialOptions:
    """How a material is fitted."""

    model: str | None = None
    """Law; that of the base profile when None."""
    fixed: dict[str, float] = field(default_factory=dict)
    """Parameters that are held, by their names in ``FIXABLE``."""
    touch_sigma_mm: float | None = None
    """How well first touch is known; chosen by tool and number of points when None."""
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT]
    """Physics of the simulated presses: that of the presses which are to reproduce the records."""
    device: str = "cpu"
    """Warp device of the simulations."""

    def __post_init__(self) -> None:
        limits = {"e": (1e2, 1e9), "nu": (0.0, 0.4999), "mooney_ratio": (0, 1), "friction": (0, 5)}
        for name, value in self.fixed.items():
            if name not in limits:
                raise InputError(
                    f"{name!r} cannot be held; use one of {', '.join(FIXABLE)}, as in nu=0.48"
                )
            require_range(name, value, *limits[name])
        if self.touch_sigma_mm is not None:
            require_range("--touch-sigma-mm", self.touch_sigma_mm, 0, 1, "mm")
