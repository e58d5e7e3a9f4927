# SPDX-License-Identifier: Apache-2.0
"""How much of a force the guard against inside-out tets is answerable for."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.potentials.elements.guard import add_guard_load
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.tangent import Tangent
from taccel_lab.state import State


def guard_force(solver: SolverIPC, state: State, moves: np.ndarray) -> np.ndarray:
    """Change of a force on tools if the guard let tets be squeezed to nothing [N], [env_count].

    ``moves``: motion of the tools' nodes per metre along the force [1], [env_count, node_count, 3].
    The force is that against the motion, at the end of the solver's last step, which led to
    ``state``. First order (``ipc.potentials.elements.guard``), by one solve with the exact matrix
    where the guard acts and nothing elsewhere: exactly 0 there. NaN where the matrix is not
    positive definite.
    """
    model = solver.model
    everyone = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)
    load = wp.zeros_like(state.positions)
    add_guard_load(solver.elastic, everyone, state.positions, load)
    loads = load.numpy()[:, model.free_nodes.numpy()]
    guarded = loads.any(axis=(1, 2))
    if not guarded.any():
        return np.zeros(model.env_count)
    tangent = Tangent(solver, state, moves, guarded, past=True)
    tangent.add_elements()
    friction = solver.friction
    tangent.add_contact(
        None
        if friction is None
        else friction.motion(state.positions, solver.origin, state.poses, solver.origin_poses)
    )
    solved = tangent.solve()
    found = (loads * solved.solution).sum(axis=(1, 2))
    known = np.array([cause is None for cause in solved.causes])
    return np.where(guarded, np.where(known, found, np.nan), 0.0)
