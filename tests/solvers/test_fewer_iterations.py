# SPDX-License-Identifier: Apache-2.0
"""Fewer iterations, the same results: starts along the last velocities, friction as a parabola."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.contact.friction import friction_gradient, friction_hessian, friction_potential
from taccel_lab.scene import TimeStepping
from taccel_lab.solvers import SolverConfig, SolverIPC, start_step
from taccel_lab.state import initial_state
from tests.support.grasps import gel_above_a_table, hand_poses


def drag() -> tuple[np.ndarray, list[int]]:
    """A gel on a mount is pressed on a block and dragged along it; positions and iterations."""
    model = gel_above_a_table(TimeStepping(quasi_static=False, dt_s=5e-3)).finalize()
    solver = SolverIPC(model, SolverConfig(dhat_m=1e-4, relative_tolerance=1e-6))
    path = [(0.0, 5e-5 - 5e-5 * k) for k in range(8)]
    path += [(2e-4 * k, path[-1][1]) for k in range(1, 25)]
    state = initial_state(model, hand_poses([path[0]]))
    iterations = []
    for place in path[1:]:
        report = solver.step(state, hand_poses([place]))
        assert report.converged.all(), report.summary()
        iterations.append(int(report.newton_iterations[0]))
    assert np.abs(solver.friction_gradient.numpy()[0, :, 0]).sum() > 0.1, "it rubs"
    return state.positions.numpy(), iterations


def test_a_steady_drag_takes_fewer_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    found, few = drag()
    monkeypatch.setattr(start_step, "plan_start", lambda run: None)
    expected, many = drag()
    np.testing.assert_allclose(found, expected, atol=2e-8)
    assert sum(few[-10:]) <= 0.8 * sum(many[-10:])


def test_a_start_that_turns_an_element_inside_out_is_not_taken() -> None:
    """The last velocities would lead the free face through the bonded one; nothing is in the way
    of them, and Newton's method would start from an energy that is infinite."""
    model = gel_above_a_table(TimeStepping(quasi_static=False, dt_s=5e-3)).finalize()
    solver = SolverIPC(model, SolverConfig(dhat_m=1e-4))
    state = initial_state(model, hand_poses([(0.0, 0.02)]))
    velocities = state.velocities.numpy()
    height = state.positions.numpy()[0, :, 2]
    gel = slice(0, model.soft_count)
    # Towards the mount, of twice the way within the step; the mount itself rises a little.
    velocities[0, gel, 2] = 2 * (height[gel].max() - height[gel]) / 5e-3 + 1e-2
    state.velocities.assign(velocities)
    report = solver.step(state, hand_poses([(0.0, 0.02 + 5e-5)]))
    assert report.converged.all(), report.summary()
    assert (report.starts_tried, report.starts_taken, report.substeps) == (1, 0, 1)


@wp.kernel(enable_backward=False)
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
