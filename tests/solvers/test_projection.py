# SPDX-License-Identifier: Apache-2.0
"""Newton's matrix: exact near the solution, projected where that is not positive definite."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.scene import Ball, Element, KinematicBody, Material, MaterialModel, Scene, SoftBody
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, pose
from tests.support.variants import variants

LAWS = (MaterialModel.NEO_HOOKEAN, MaterialModel.STABLE_NEO_HOOKEAN)
WIDTH_M, LENGTH_M, YOUNG_PA = 1e-3, 1e-2, 1e5
EULER_N = np.pi**2 * YOUNG_PA * WIDTH_M**4 / 12 / (2 * LENGTH_M) ** 2
"""Load under which a bar that is held at one end buckles."""


def newton_of_a_press(tolerance: float, model: MaterialModel, element: Element) -> int:
    """Iterations of the second of two steps of a ball into a nearly incompressible gel."""
    cells = (6, 6, 3) if element is Element.LINEAR else (4, 4, 2)
    gel = SoftBody(
        block_mesh(cells, (6e-3, 6e-3, 2.5e-3)), Material(1e5, 0.46, model=model), element=element
    )
    scene = Scene(gel, KinematicBody(Ball(3e-3))).finalize()
    config = SolverConfig(relative_tolerance=tolerance, absolute_tolerance_n=1e-12)
    solver, state = SolverIPC(scene, config), initial_state(scene, pose(0, 0, 3.05e-3)[None, None])
    for depth in (6e-4, 6.5e-4):
        report = solver.step(state, pose(0, 0, 3e-3 - depth)[None, None])
        assert report.converged[0], report.summary()
    return int(report.newton_iterations[0])


@pytest.mark.parametrize(
    ("model", "element"),
    variants([(LAWS[0], Element.QUADRATIC), (LAWS[1], Element.LINEAR)], LAWS, Element),
)
def test_it_converges_quadratically_under_prestress(model: MaterialModel, element: Element) -> None:
    """Six more digits in two or three iterations; projected matrices alone took six and more."""
    rough = newton_of_a_press(1e-3, model, element)
    assert newton_of_a_press(1e-9, model, element) <= rough + 3


@pytest.mark.thorough
def test_it_gets_away_from_a_saddle_by_longer_and_longer_steps() -> None:
    """A peg whose grip slips on the rim: 22, 16 and 20 iterations in three of its steps by those
    that all have the length of Newton's, 17, 16 and 15 by these."""
    bench = build_scene("peg", SceneOptions(1, "generated", {}))
    model = bench.scene.finalize()
    solver, state = SolverIPC(model, bench.config), initial_state(model, bench.targets(0))
    iterations = []
    for k in range(1, 90):
        report = solver.step(state, bench.targets(k))
        assert report.converged[0], report.summary()
        iterations.append(int(report.newton_iterations[0]))
    assert sum(sorted(iterations[60:])[-3:]) < 54


def bar() -> tuple[SolverIPC, np.ndarray]:
    """A bar that stands on the floor, and the nodes of its upper end."""
    mesh = block_mesh((2, 2, 10), (WIDTH_M, WIDTH_M, LENGTH_M))
    body = SoftBody(mesh, Material(YOUNG_PA, 0.3), element=Element.QUADRATIC)
    model = Scene(body).finalize()
    top = np.flatnonzero(model.rest_positions.numpy()[0, :, 2] > -1e-9)
    return SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-9)), top


@pytest.mark.thorough
def test_a_bar_that_is_pressed_too_hard_bends() -> None:
    """Straight it is in balance too, but that is a saddle, which projected matrices alone do not
    leave in 1,800 iterations, and where the exact one is indefinite."""
    solver, top = bar()
    model, state = solver.model, initial_state(solver.model)
    leans = []
    for load in (0.8, 1.2):
        forces = np.zeros((1, model.node_count, 3))
        forces[0, top] = [1e-4 * EULER_N / len(top), 0, -load * EULER_N / len(top)]
        state.load(model, forces)
        report = solver.step(state)
        assert report.converged[0], report.summary()
        leans.append(abs(state.positions.numpy()[0, top, 0].mean()))
    assert leans[0] < 0.01 * LENGTH_M
    assert leans[1] > 0.3 * LENGTH_M
    assert report.newton_iterations[0] < 300
