# SPDX-License-Identifier: Apache-2.0
"""What a linear solve did, per environment, read back to the host."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.ipc.linear.problem import LinearProblem


@dataclass(frozen=True)
class LinearReport:
    """Arrays of shape [env_count]; environments that were not active read 0, 0 and False."""

    iterations: np.ndarray
    """CG iterations, int64."""
    relative_residual: np.ndarray
    """True residual ||rhs - H p|| / ||rhs|| of the solution, float64, but for what rounding adds
    where the matrix is rounded and not verified (``VERIFY_BELOW``); 0 when rhs is 0, and where a
    factorisation of the whole matrix gave the solution and nobody measured it."""
    breakdown: np.ndarray
    """Whether the solve stopped early because the matrix is not positive definite or a number is
    not finite; the solution is then the last good iterate, at worst zero. bool."""

    @classmethod
    def read(cls, problem: LinearProblem) -> LinearReport:
        """Copy the figures of the last solve to the host; waits for the device."""
        return cls(
            iterations=problem.iterations.numpy().astype(np.int64),
            relative_residual=problem.residuals.numpy().copy(),
            breakdown=problem.breakdown.numpy() != 0,
        )
