# SPDX-License-Identifier: Apache-2.0
"""Elastic forces of a state, with the moduli of its gels or with others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from taccel_lab.model.elastic import ElementArrays
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State


def elastic_gradient(
    solver: SolverIPC, state: State, groups: Sequence[ElementArrays] | None = None
) -> np.ndarray:
    """d(elastic energy)/dx of all nodes [N], shape [env_count, node_count, 3].

    ``groups``: the elements of ``model.elastic`` with other moduli or volumes to take the forces
    with; as they are when None.
    """
    active = wp.full(solver.model.env_count, 1, dtype=wp.int32, device=solver.model.device)
    gradient = wp.zeros_like(state.positions)
    for part, group in zip(solver.elastic, groups or solver.model.elastic, strict=True):
        data = part.data
        own = data.moduli.mu, data.moduli.lam, data.moduli.ratio, data.volumes
        data.moduli.mu, data.moduli.lam = group.mu, group.lam
        data.moduli.ratio, data.volumes = group.mooney_ratio, group.volumes
        try:
            part.add_gradient(active, state.positions, gradient)
        finally:
            data.moduli.mu, data.moduli.lam, data.moduli.ratio, data.volumes = own
    return gradient.numpy()
