# SPDX-License-Identifier: Apache-2.0
"""What a step did, per environment: numbers first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
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
    """A position, residual or search direction was not finite."""
    FRICTION = 5
    """Re-freezing friction did not settle."""
    INVERSION = 6
    """An element was inverted before the step; or by it, in a material whose energy bears that."""
    CONTACT_OVERFLOW = 7
    """More contacts than ``SolverConfig.max_collisions``, or than there is memory for."""
    JOINT = 8
    """A joint stayed open by more than its tolerance."""
    TOUCHING = 9
    """Two surfaces touched or crossed before the step: no motion is free of collisions."""
    SKIPPED = 10
    """The environment was not asked for."""
    OVERLAP = 11
    """Bodies overlapped before the first step, see ``SolverIPC.step``."""
    IMPACT = 12
    """BDF2 met an impact: the solver takes the step again by implicit Euler at once."""


@dataclass(frozen=True)
class StepReport:
    """Per-environment arrays of shape [env_count], unless said otherwise."""

    status: np.ndarray
    """``EnvStatus``; environments that did not converge were rolled back."""
    newton_iterations: np.ndarray
    cg_iterations: np.ndarray
    """Sum over the step of the (batched) CG iterations while the environment was active."""
    friction_lags: np.ndarray
    """How often friction was frozen anew."""
    searches: np.ndarray
    """How often pairs were searched for; see ``ipc.broad_phase.kept_pairs``."""
    ccd_passes: np.ndarray
    """How many ways were checked for collisions; see ``solvers.limit_step``."""
    starts_tried: np.ndarray
    """Starts away from where the environment was; see ``solvers.start_step``."""
    starts_taken: np.ndarray
    residual_n: np.ndarray
    """Force residual at the end, friction re-frozen: the largest sum of magnitudes over the nodes
    of a body [N]."""
    residual_ratio: np.ndarray
    """The largest of a body over what is allowed that body, at most 1 where the step converged.
    ``SolverIPC.progress.data`` has ``body_residuals`` and ``body_forces``, [env_count, body_count].
    """
    contact_force_n: np.ndarray
    """Sum of the magnitudes of the nodal contact forces on one side, the scale of the tolerance
    [N]."""
    min_distance_m: np.ndarray
    """Smallest gap of any pair within dhat [m]; infinite without contact."""
    smallest_step: np.ndarray
    """Smallest accepted step length of the line search."""
    joint_violation_m: np.ndarray
    """Largest violation of a joint's constraint [m]; 0 without joints."""
    substeps: np.ndarray
    """Parts the step was taken in: 1 unless it failed as a whole."""
    seconds: float
    """Wall time of the whole call, all environments."""

    @property
    def converged(self) -> np.ndarray:
        """Whether each environment reached its tolerance."""
        return self.status == EnvStatus.CONVERGED

    def retaken(self, later: StepReport, who: np.ndarray) -> StepReport:
        """The same step, but what ``later`` says of the environments ``who`` that took it again."""
        names = [field.name for field in fields(self) if field.name != "seconds"]
        return replace(
            self,
            **{name: np.where(who, getattr(later, name), getattr(self, name)) for name in names},
        )

    def followed_by(self, later: StepReport) -> StepReport:
        """The end of ``later`` with the work of both; environments it skipped stay as they are."""

        def newer(name: str) -> np.ndarray:
            skipped = later.status == EnvStatus.SKIPPED
            return np.where(skipped, getattr(self, name), getattr(later, name))

        return replace(
            self,
            **{
                name: newer(name)
                for name in (
                    "status",
                    "residual_n",
                    "residual_ratio",
                    "contact_force_n",
                    "min_distance_m",
                    "joint_violation_m",
                )
            },
            **{
                name: getattr(self, name) + getattr(later, name)
                for name in (
                    "newton_iterations",
                    "cg_iterations",
                    "friction_lags",
                    "searches",
                    "ccd_passes",
                    "starts_tried",
                    "starts_taken",
                    "substeps",
                    "seconds",
                )
            },
            smallest_step=np.minimum(self.smallest_step, later.smallest_step),
        )

    def failures(self) -> dict[str, list[int]]:
        """Environments that failed, by cause."""
        causes: dict[str, list[int]] = {}
        for env in np.flatnonzero(~self.converged & (self.status != EnvStatus.SKIPPED)):
            causes.setdefault(EnvStatus(self.status[env]).name, []).append(int(env))
        return causes

    def summary(self) -> str:
        """One line for a log."""
        good = int(self.converged.sum())
        line = (
            f"{good}/{len(self.status)} converged, "
            f"Newton {self.newton_iterations.max()}, CG {self.cg_iterations.max()}, "
            f"residual {self.residual_n.max():.2e} N of {self.contact_force_n.max():.3g} N, "
            f"min distance {self.min_distance_m.min() * 1e6:.2f} um, "
            f"smallest step {self.smallest_step.min():.2g}, {self.seconds:.2f} s"
        )
        if self.substeps.max() > 1:
            line += f", up to {self.substeps.max()} substeps"
        if causes := self.failures():
            line += "; " + ", ".join(f"{name}: {envs}" for name, envs in causes.items())
        return line

    def describe(self, environments: Sequence[int] | None = None) -> str:
        """A table for people, one line an environment: all of them, or those given."""
        columns = "env  status             Newton    CG  lags  parts   residual [N]  contact [N]"
        lines = [columns + "  gap [um]  smallest step"]
        for env in range(len(self.status)) if environments is None else environments:
            lines.append(
                f"{env:>3}  {EnvStatus(self.status[env]).name:<17}"
                f"{self.newton_iterations[env]:>8}{self.cg_iterations[env]:>6}"
                f"{self.friction_lags[env]:>6}{self.substeps[env]:>7}"
                f"{self.residual_n[env]:>15.2e}{self.contact_force_n[env]:>13.4g}"
                f"{self.min_distance_m[env] * 1e6:>10.3f}{self.smallest_step[env]:>15.3g}"
            )
        return "\n".join(lines)
