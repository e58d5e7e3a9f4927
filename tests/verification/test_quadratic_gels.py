# SPDX-License-Identifier: Apache-2.0
"""Gels of quadratic tets in the solver: environments, other gels, signals, tets inside out."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.bodies.material import MaterialModel
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.ipc.intersection import find_intersections
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
)
from taccel_lab.signals import SignalTactile
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.report import EnvStatus
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, everywhere, pose
from tests.verification.curved_tets import CURVED, curved
from tests.verification.test_press import COARSE as MESH

DHAT = 2e-5


def gel(poisson: float = 0.45, **options) -> SoftBody:
    return SoftBody(MESH, Material(1e5, poisson), element=Element.QUADRATIC, **options)


def test_environments_do_not_see_each_other() -> None:
    """Bitwise the same alone and among others, with a rest shape of its own."""
    rests = np.stack([MESH.nodes_m, MESH.nodes_m * [1.05, 1.0, 0.9]])
    results = []
    for chosen in ([0, 1], [1]):
        count = len(chosen)
        body = gel(rest_positions_m=rests[chosen])
        model = Scene(body, KinematicBody(Ball(1.5e-3), 0.5), count).finalize()
        solver = SolverIPC(model)
        state = initial_state(model, everywhere(count, pose(0, 0, 1.6e-3)))
        for z in (1.4e-3, 1.2e-3):
            report = solver.step(state, everywhere(count, pose(1e-4, 0, z)))
            assert report.converged.all(), report.summary()
        results.append(state.positions.numpy()[-1])
    np.testing.assert_array_equal(results[0], results[1])


def test_gels_of_unlike_elements_press_on_each_other() -> None:
    lower = gel(0.45)
    upper = SoftBody(
        block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.1),
        Material(2e5, 0.4),
        name="upper",
        mount="hand",
        element=Element.LINEAR,
    )
    model = Scene([lower, upper], KinematicBody(None, name="hand")).finalize()
    assert len(model.elastic) == 2
    solver = SolverIPC(model, SolverConfig(dhat_m=DHAT))

    def facing(gap: float) -> np.ndarray:
        return everywhere(1, pose(0, 0, gap, (1, 0.02, 0), 180))

    state = initial_state(model, facing(3e-4))
    for gap in (-1e-4, -3e-4):
        report = solver.step(state, facing(gap))
        assert report.converged.all(), report.summary()
        assert find_intersections(model, state) == [[]]
    contact = solver.contact_gradient.numpy()[0]
    first, second = (contact[model.bodies[i].node_slice].sum(axis=0) for i in (0, 1))
    assert abs(first[2]) > 1e-2
    np.testing.assert_allclose(first, -second, atol=1e-12 * np.abs(contact).sum())


def test_signals_read_all_nodes_of_the_surface() -> None:
    """The height map of a paraboloid through the nodes: middles are part of the surface."""
    body = gel()
    mesh = body.nodal_mesh
    x = mesh.nodes_m.copy()
    on_top = mesh.region_nodes(Region.CONTACT)
    x[on_top, 2] -= 10.0 * (x[on_top, :2] ** 2).sum(axis=1)
    grid = PixelGrid(40, 30, 0.1, 0.1)
    heights = []
    for gel_mesh, nodes in ((mesh, x), (MESH, x[: MESH.node_count])):
        reader = SignalTactile(gel_mesh, grid, env_count=1)
        reader.update(wp.array(nodes[None], dtype=wp.vec3d, device="cpu"))
        heights.append(reader.height_m.numpy()[0])
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    height = -10.0 * 1e-6 * (x_mm**2 + y_mm**2)
    errors = [np.abs(found - height).max() for found in heights]
    assert errors[0] < 0.3 * errors[1]
    assert errors[0] < 2e-6


@pytest.mark.parametrize("law", list(MaterialModel))
def test_a_step_that_leaves_a_tet_inside_out_between_its_corners_is_no_result(
    law: MaterialModel,
) -> None:
    """Held nodes bend one tet; no corner, no quadrature point and no energy tells."""
    soft = SoftBody(CURVED, Material(1e5, 0.3, model=law), np.arange(4), element=Element.QUADRATIC)
    model = Scene(soft, time=TimeStepping(quasi_static=False, dt_s=1e-5), env_count=2).finalize()
    solver, state = SolverIPC(model), initial_state(model)
    places = state.positions.numpy()
    # The second environment bends it a little only.
    state.positions.assign(places + np.stack([curved(soft), curved(soft, 0.2)]))
    start = state.positions.numpy()
    report = solver.step(state)
    # A material that bears inversion may start so; then nothing was lost by the step.
    bears = law in (MaterialModel.STABLE_NEO_HOOKEAN, MaterialModel.ST_VENANT_KIRCHHOFF)
    first = EnvStatus.CONVERGED if bears else EnvStatus.INVERSION
    assert [EnvStatus(status) for status in report.status] == [first, EnvStatus.CONVERGED]
    if not bears:
        np.testing.assert_array_equal(state.positions.numpy()[0], start[0])
