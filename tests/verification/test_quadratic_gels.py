# SPDX-License-Identifier: Apache-2.0
"""Gels of quadratic tets in the solver: contact, friction, mounts, dynamics, other gels."""

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
from tests.verification.test_press import INDENTERS, path
from tests.verification.test_stress import MAX_DEPTH, advance, next_pose, random_shape, reach

DHAT = 2e-5
MESH = block_mesh((4, 4, 2), (6e-3, 6e-3, 2.4e-3), jitter=0.15)


def gel(poisson: float = 0.45, **options) -> SoftBody:
    return SoftBody(MESH, Material(1e5, poisson), element=Element.QUADRATIC, **options)


@pytest.mark.parametrize(
    ("name", "friction"), [("ball", 0.7), ("sphere mesh", 0.0), ("box", 0.5), ("concave", 0.5)]
)
def test_every_frame_is_converged_separate_and_balanced(name: str, friction: float) -> None:
    shape, lowest = INDENTERS[name]
    body = gel()
    model = Scene(body, KinematicBody(shape, friction)).finalize()
    solver = SolverIPC(model, SolverConfig(dhat_m=DHAT))
    state = initial_state(model, everywhere(1, pose(0, 0, lowest + 3 * DHAT)))
    soft = slice(0, model.soft_count)
    largest = 0.0
    for target in path(lowest):
        report = solver.step(state, everywhere(1, target))
        assert report.converged.all(), report.summary()
        assert find_intersections(model, state) == [[]]
        contact = solver.contact_gradient.numpy()[0]
        rubbing = solver.friction_gradient.numpy()[0]
        force = np.abs(contact[soft]).sum()
        largest = max(largest, force)
        # The elastic reaction at the glued back balances the load.
        elastic = wp.zeros_like(state.positions)
        everyone = wp.full(1, 1, dtype=wp.int32)
        solver.elastic[0].add_gradient(everyone, state.positions, elastic)
        bonded = elastic.numpy()[0][body.nodal_mesh.bonded_nodes()].sum(axis=0)
        load = (contact + rubbing)[soft].sum(axis=0)
        slack = report.residual_n[0]
        np.testing.assert_allclose(bonded, load, atol=slack)
        assert np.linalg.norm(rubbing[soft].sum(axis=0)) <= friction * force * (1 + 1e-3)
    assert largest > 1e-3
    assert report.contact_force_n[0] == 0, "the body has left the gel"
    rest = model.rest_positions.numpy()[0, soft]
    np.testing.assert_allclose(state.positions.numpy()[0, soft], rest, atol=2e-6)


@pytest.mark.parametrize("presses", [10, pytest.param(60, marks=pytest.mark.slow, id="60 presses")])
def test_rough_presses_never_intersect(presses: int) -> None:
    parts: list[int] = []
    for seed in range(presses):
        rng = np.random.default_rng(1000 + seed)
        friction, poisson = float(rng.choice([0, 0.3, 1.0])), float(rng.choice([0.3, 0.45, 0.499]))
        body = KinematicBody(random_shape(rng), friction)
        model = Scene(gel(poisson), body).finalize()
        solver = SolverIPC(model, SolverConfig(dhat_m=float(rng.choice([5e-6, 2e-5, 1e-4]))))
        x, y = rng.uniform(-1e-3, 1e-3, 2)
        axis = rng.normal(size=3)
        high = reach(body.shape) + 2e-4
        placed = pose(x, y, high, (axis[0], axis[1], axis[2]), rng.uniform(0, 180))
        state = initial_state(model, everywhere(1, placed))
        for _ in range(5):
            now = state.poses.numpy().reshape(1, 1, 7)
            target = next_pose(now, reach(body.shape) - MAX_DEPTH, rng)
            parts.append(advance(solver, state, target))
    counts = np.array(parts)
    assert (counts == 0).sum() <= 1 + 0.02 * len(counts)
    assert (counts == 1).mean() > 0.9


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


def test_a_mounted_gel_meets_the_ball_as_the_ball_meets_the_gel() -> None:
    moves = [-1.4e-3, -1.2e-3, -1.0e-3]
    ball, finger = KinematicBody(Ball(1.5e-3), 0.0), KinematicBody(None, name="finger")
    forces = []
    for mounted in (False, True):
        bodies = (ball, finger) if mounted else (ball,)
        model = Scene(gel(mount="finger" if mounted else None), bodies).finalize()
        solver = SolverIPC(model, SolverConfig(relative_tolerance=1e-7))

        def placed(z: float, mounted: bool = mounted) -> np.ndarray:
            if mounted:
                return everywhere(1, pose(0, 0, 0), pose(0, 0, z))
            return everywhere(1, pose(0, 0, -z))

        state = initial_state(model, placed(-1.6e-3))
        for z in moves:
            report = solver.step(state, placed(z))
            assert report.converged.all(), report.summary()
        forces.append(solver.contact_gradient.numpy()[0, : model.soft_count, 2].sum())
    assert forces[0] > 1e-3
    assert forces[1] == pytest.approx(forces[0], rel=1e-5)


def test_momentum_of_a_free_body() -> None:
    """Linear and angular momentum of a flying, wobbling block to rounding of the solve."""
    mesh = block_mesh((2, 2, 2), (2e-3, 2e-3, 2e-3), jitter=0.2)
    body = SoftBody(
        mesh, Material(1e5, 0.49), np.zeros(0, dtype=np.int64), element=Element.QUADRATIC
    )
    # Short against the slowest vibration, or the first step would damp it all.
    time = TimeStepping(quasi_static=False, dt_s=1e-4)
    model = Scene(body, time=time).finalize()
    masses = model.masses.numpy()[0][:, None]
    solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-13))
    state = initial_state(model, np.zeros((1, 0, 7)))
    rest = model.rest_positions.numpy()[0]
    velocity = 0.01 + np.cross([0.5, 0.2, -0.4], rest - rest.mean(axis=0)) + 0.3 * rest[:, ::-1]
    state.velocities = wp.array(velocity[None], dtype=wp.vec3d)

    momentum = np.abs(masses * velocity).sum()
    for _ in range(4):
        before = state.velocities.numpy()[0].copy()
        report = solver.step(state)
        assert report.converged.all(), report.summary()
        gained = masses * (state.velocities.numpy()[0] - before)
        scale = np.abs(gained).sum()
        assert scale > 1e-4 * momentum
        np.testing.assert_allclose(gained.sum(axis=0), 0, atol=1e-10 * momentum)
        # Central forces at the end of the step have no moment.
        moment = np.cross(state.positions.numpy()[0], gained).sum(axis=0)
        np.testing.assert_allclose(moment, 0, atol=1e-10 * momentum * np.abs(rest).max())


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
