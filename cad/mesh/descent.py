# SPDX-License-Identifier: Apache-2.0
"""The descent behind both smoothings, the same on any number of cores."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.processes.one_thread import one_blas_thread


def descend(
    energy: Callable[[np.ndarray], tuple[float, np.ndarray]], count: int, iterations: int
) -> np.ndarray:
    """Steps [count] from zero that lower ``energy``, which returns value and gradient, by L-BFGS-B
    in at most ``iterations`` iterations."""
    from scipy.optimize import minimize

    with one_blas_thread():
        found = minimize(
            energy, np.zeros(count), jac=True, method="L-BFGS-B",
            options={"maxiter": iterations, "maxcor": 12},
        )  # fmt: skip
    return found.x
