# SPDX-License-Identifier: Apache-2.0
"""A profile on its way through the blocks: what the next one builds on, and what is handed out."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.calibration.result import BlockResult
from taccel_lab.calibration.scored_fit import ScoredFit
from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class Profiles:
    """The same object twice until a model is fitted to held-out presses, too."""

    basis: SensorProfile
    """Nothing in it has seen the presses that blocks hold out, which are the same ones."""
    final: SensorProfile

    @classmethod
    def of(cls, profile: SensorProfile) -> Profiles:
        """One that is both."""
        return cls(profile, profile)

    def after(self, result: BlockResult) -> Profiles:
        """Both with what a block found; errors of ``apply_to``."""
        scored = result.scored if isinstance(result, ScoredFit) else result
        final = result.apply_to(self.final)
        alike = self.basis is self.final and scored is result
        return Profiles(final if alike else scored.apply_to(self.basis), final)
