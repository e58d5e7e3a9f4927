# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of the training of a force model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from taccel_lab.errors import InputError
from taccel_lab.guards import require_seed


@dataclass(frozen=True, kw_only=True)
class ForceOptions:
    """Settings of ``calibrate_force``."""

    steps: int = 6000
    """Training batches; one of 64 images takes 0.3 s of a CPU core, 5 ms of a GPU."""
    batch: int = 64
    """Images in a batch."""
    learning_rate: float = 2e-3
    """Its peak; it rises and falls once."""
    device: str = "cpu"
    """Device of the training: cpu, or cuda."""
    seed: int = 0
    """Seed of weights, batches and drawn lights."""
    markers: Literal["auto", "on", "off"] = "auto"
    """Marker displacements are an input too. auto: if profile and data set have them."""
    light: float = 1.0
    """Variation of the light in the training, times the profile's spread (block perturbation);
    0: none."""
    stiffness: float | None = None
    """Relative standard deviation of a unit's modulus, added to the stated errors. Default: the
    profile's."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 < self.learning_rate < 1:
            raise InputError(f"learning_rate must lie in 0..1, got {self.learning_rate}")
        if not 0 <= self.light <= 10:
            raise InputError(f"light must lie in 0..10, got {self.light}")
        if self.stiffness is not None and not 0 <= self.stiffness < 1:
            raise InputError(f"stiffness must lie in 0..1, got {self.stiffness}")
        require_seed(self.seed)
