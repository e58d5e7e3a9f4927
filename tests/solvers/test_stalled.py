# SPDX-License-Identifier: Apache-2.0
"""Iterations that lead nowhere end a step; plateaus on which the energy falls do not."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import Ball, KinematicBody, Material, Scene, SoftBody
from taccel_lab.solvers import EnvStatus, SolverIPC
from taccel_lab.solvers.env_phase import STALL_AFTER, STEPPING, forget_gain, go_on
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.solver_ipc import HALVING_HELPS

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _begin_kernel(p: Progress):
    forget_gain(wp.tid(), p)


@wp.kernel
def _go_on_kernel(p: Progress):
    go_on(wp.tid(), p)


K = np.arange(400)
COURSES = {
    # Residual over what is allowed, energy [J], progress of the frames, where it stalls.
    "nothing falls": (0 * K + 5e3, 0 * K + 1.0, 0 * K + 1.0, STALL_AFTER + 1),
    "rise and fall about a level": (3e3 + 2e3 * np.sin(K), 1 + 1e-3 * np.sin(K), 0 * K + 1.0, ...),
    "residual falls by 2 % in 50": (5e3 * 0.98 ** (K // 50), 0 * K + 1.0, 0 * K + 1.0, None),
    "energy falls on a plateau": (5e3 + 4e3 * np.sin(K), 1 - 1e-5 * K, 0 * K + 1.0, None),
    "energy falls below zero": (5e3 + 0.0 * K, -1 - 1e-5 * K, 0 * K + 1.0, None),
    "frames creep on": (0 * K + 5e3, 0 * K + 1.0, 2e-3 * K / 50, None),
    "frames are stuck": (5e3 * 0.9**K, 1 - 1e-2 * K, np.minimum(0.9, 0.1 * K), STALL_AFTER + 10),
    "stalled after 200": (5e3 * 0.9 ** np.minimum(K, 200), 0 * K + 1.0, 0 * K + 1.0, 301),
    "energy is not known": (5e3 * 0.9**K, 0 * K + np.inf, 0 * K + 1.0, None),
}


def test_a_step_ends_after_so_many_iterations_without_a_gain() -> None:
    gel = SoftBody(block_mesh((1, 1, 1), (1e-2, 1e-2, 1e-2)), Material(1e5, 0.4))
    model = Scene(gel, KinematicBody(Ball(1e-3)), len(COURSES)).finalize("cpu")
    p = SolverIPC(model).progress
    p.phases.active.fill_(1)
    p.phases.phase.fill_(STEPPING)
    wp.launch(_begin_kernel, len(COURSES), inputs=[p.struct])
    ended: list[int | None] = [None] * len(COURSES)
    for k in K:
        for i, array in enumerate((p.balance.excess, p.search.after, p.prescribed.progress)):
            array.assign(np.array([course[i][k] for course in COURSES.values()], dtype=float))
        wp.launch(_go_on_kernel, len(COURSES), inputs=[p.struct])
        for env in np.flatnonzero(p.phases.status.numpy() == EnvStatus.STALLED):
            ended[env] = int(k) if ended[env] is None else ended[env]
    for name, found in zip(COURSES, ended, strict=True):
        expected = COURSES[name][3]
        if expected is ...:
            assert found is not None and found < STALL_AFTER + 50, name
        else:
            assert found == expected, name
    assert (p.phases.active.numpy() == np.array([k is None for k in ended])).all()

    # Shorter steps may help.
    assert EnvStatus.STALLED in HALVING_HELPS
