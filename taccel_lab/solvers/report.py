# SPDX-License-Identifier: Apache-2.0
"""What a step did, per environment: numbers first."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np


class EnvStatus(IntEnum):
    """How a step ended in one environment."""

    RUNNING = 0
    CONVERGED = 1
    NO_CONVERGENCE = 2
    """The Newton iterations were used up."""
    LINE_SEARCH = 3
    """No step along the search direction lowered the energy."""
    NOT_A_NUMBER = 4
    """A residual or a search direction was not finite."""
    FRICTION = 5
    """Re-freezing friction did not settle."""


@dataclass(frozen=True)
class StepReport:
    """Per-environment arrays of shape [env_count], unless said otherwise."""

    status: np.ndarray
    """``EnvStatus``; environments that did not converge were rolled back."""
    newton_iterations: np.ndarray
    cg_iterations: np.ndarray
    """Sum over the step of the (batched) CG iterations while the environment was active."""
    friction_lags: np.ndarray
    residual_n: np.ndarray
    """Euclidean norm of the nodal force residual at the end, friction re-frozen [N]."""
    contact_force_n: np.ndarray
    """Sum of the magnitudes of the nodal contact forces, the scale of the tolerance [N]."""
    min_distance_m: np.ndarray
    """Smallest gap of any pair within dhat [m]; infinite without contact."""
    smallest_step: np.ndarray
    """Smallest accepted step length of the line search."""
    seconds: float
    """Wall time of the whole call, all environments."""

    @property
    def converged(self) -> np.ndarray:
        """Whether each environment reached its tolerance."""
        return self.status == EnvStatus.CONVERGED

    def followed_by(self, later: StepReport) -> StepReport:
        """The end of ``later`` with the work of both."""
        return replace(
            later,
            newton_iterations=self.newton_iterations + later.newton_iterations,
            cg_iterations=self.cg_iterations + later.cg_iterations,
            friction_lags=self.friction_lags + later.friction_lags,
            smallest_step=np.minimum(self.smallest_step, later.smallest_step),
            seconds=self.seconds + later.seconds,
        )

    def summary(self) -> str:
        """One line for a log."""
        good = int(self.converged.sum())
        return (
            f"{good}/{len(self.status)} converged, "
            f"Newton {self.newton_iterations.max()}, CG {self.cg_iterations.max()}, "
            f"residual {self.residual_n.max():.2e} N of {self.contact_force_n.max():.3g} N, "
            f"min distance {self.min_distance_m.min() * 1e6:.2f} um, {self.seconds:.2f} s"
        )
