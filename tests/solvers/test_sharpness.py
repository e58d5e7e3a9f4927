# SPDX-License-Identifier: Apache-2.0
"""Friction as a parabola after a step that overshot: a bound from above, and fewer iterations."""

from __future__ import annotations

import numpy as np
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.contact.friction import friction_gradient, friction_hessian, friction_potential
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, pose


@wp.kernel
def _evaluate_kernel(
    u: wp.array(dtype=wp.vec3d),
    v: wp.array(dtype=wp.vec3d),
    eps: wp.float64,
    bounds: wp.array(dtype=wp.float64),
):
    """Parabola at u evaluated at v, less the potential at v."""
    i = wp.tid()
    normal = wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
    one = wp.float64(1.0)
    h = friction_hessian(normal, u[i], one, eps, wp.float64(0.0))
    step = v[i] - u[i]
    parabola = friction_potential(u[i], one, eps) + wp.dot(friction_gradient(u[i], one, eps), step)
    parabola += wp.float64(0.5) * wp.dot(step, h * step)
    bounds[i] = parabola - friction_potential(v[i], one, eps)


@given(seed=st.integers(0, 2**31), scale=st.floats(0.01, 100.0))
def test_the_parabola_lies_above_the_potential(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    eps = 1e-6
    points = [np.column_stack([rng.normal(size=(64, 2)) * scale * eps, np.zeros(64)]) for _ in "uv"]
    u, v = (wp.array(p, dtype=wp.vec3d, device="cpu") for p in points)
    bounds = wp.zeros(64, dtype=wp.float64, device="cpu")
    wp.launch(_evaluate_kernel, 64, inputs=[u, v, eps], outputs=[bounds], device="cpu")
    assert (bounds.numpy() >= -1e-14 * scale * eps).all()


def test_a_rough_press_takes_few_iterations() -> None:
    """86 when written; 135 with the Newton matrix of friction alone."""
    gel = SoftBody(
        block_mesh((10, 10, 4), (6e-3, 6e-3, 2.5e-3)),
        Material(1e5, 0.45),
        friction_coefficient=1.0,
        element=Element.LINEAR,
    )
    model = Scene(gel, KinematicBody(Ball(2e-3), 1.0)).finalize()
    solver = SolverIPC(model, SolverConfig())
    state = initial_state(model, pose(0.1e-3, 0, 2.05e-3)[None, None])
    iterations = []
    for k in range(1, 9):
        report = solver.step(state, pose(0.1e-3, 0, 2.05e-3 - 8e-5 * k)[None, None])
        assert report.converged.all(), report.summary()
        iterations.append(int(report.newton_iterations[0]))
    assert report.contact_force_n[0] > 0.01
    assert sum(iterations) <= 100, iterations
