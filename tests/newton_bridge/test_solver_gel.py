# SPDX-License-Identifier: Apache-2.0
"""Gels in newton's simulations: forces in balance, bodies as in our own solve, worlds alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from tests.newton_bridge.squeezed_cube import (
    GELS,
    MASS,
    PAD,
    BodyGel,
    Coupling,
    Simulation,
    SolverGel,
    coupled,
    cube_builder,
    cube_model,
    free_bodies,
    jaws,
    monolithic,
    newton,
)

SensorTactile = pytest.importorskip("taccel_lab.newton_bridge.sensor_tactile").SensorTactile


@pytest.mark.thorough
def test_a_cube_inside_moves_as_in_our_own_solve() -> None:
    ours, theirs = monolithic(1e-3), coupled(1e-3, Coupling.INSIDE)
    grip = ours.grip_impulse() / 20
    assert ours.on_gels[-1, :, 0] == pytest.approx([-1.334, 1.334], rel=1e-3)
    # Positions of some mm come out with 24 bits.
    np.testing.assert_allclose(theirs.positions, ours.positions, atol=1e-9)
    np.testing.assert_allclose(theirs.forces, ours.forces, atol=1e-5)
    for run in (ours, theirs):
        # Steps end at a force residual of 1e-6 of the contact forces.
        assert np.abs(run.imbalance()).max() < 1e-5 * grip
        np.testing.assert_allclose(run.forces + run.on_gels.sum(axis=1), 0, atol=1e-12)


@pytest.mark.thorough
def test_a_lagged_cube_comes_to_our_own_solve_with_the_step() -> None:
    errors = []
    for dt in (1e-4, 5e-5):
        ours, theirs = monolithic(dt, 3e-3), coupled(dt, Coupling.LAGGED, 3e-3)
        np.testing.assert_allclose(theirs.forces + theirs.on_gels.sum(axis=1), 0, atol=1e-12)
        errors.append(np.abs(theirs.positions - ours.positions).max())
        late = theirs.imbalance()[1:] + dt * np.diff(theirs.forces, axis=0)
        # What moved the cube in a step is the wrench of the one before, to FP32 velocities.
        assert np.abs(late).max() < 1e-6 * MASS
    assert errors[1] < 0.7 * errors[0] < 5e-6


def test_what_others_do_to_a_body_inside_is_followed() -> None:
    run = Simulation(cube_model())
    poses, rates = run.poses(), run.state.body_qd.numpy().copy()
    turn = np.array([0.0, np.sin(0.15), 0.0, np.cos(0.15)])
    poses[2], rates[2] = [0, 0, 0.05, *turn], [0.1, 0, 0.2, 0, 3.0, 0]
    push = np.zeros((3, 6), dtype=np.float32)
    push[2] = [0, 2 * MASS, MASS * 9.81, 0, 0, 0]
    dt = 1e-3
    run.state.body_q.assign(poses)
    run.state.body_qd.assign(rates)
    for _ in range(10):
        run.state.body_f.assign(push)
        run.step(dt)
    after = run.poses()[2].astype(np.float64)
    assert run.state.body_qd.numpy()[2, :3] == pytest.approx([0.1, 2 * 10 * dt, 0.2], abs=1e-6)
    # Implicit Euler: a dt^2 n (n + 1) / 2.
    assert after[:3] == pytest.approx([1e-3, 2 * dt**2 * 55, 0.052], abs=1e-7)
    # It turns about its own axis at 3 rad/s, less what implicit Euler loses.
    assert 2 * np.arctan2(after[4], after[6]) == pytest.approx(0.3 + 0.03, abs=2e-4)
    assert run.solver.wrenches[2] == pytest.approx(np.zeros(6), abs=1e-12)
    assert run.state.joint_q.numpy()[-7:] == pytest.approx(after, abs=1e-7)


@pytest.mark.thorough
def test_a_body_bounces_on_its_gel() -> None:
    """Newton's solver knows no contact: only the gel's wrench holds 50 g, around 0.1 mm deep."""
    builder, inertia = newton.ModelBuilder(), wp.mat33(np.eye(3) * 1e-5)
    builder.add_ground_plane()
    down = wp.transform((0, 0, 5.5e-5), wp.quat(1.0, 0.0, 0.0, 0.0))
    block = builder.add_body(xform=down, mass=0.05, inertia=inertia, label="block")
    model = builder.finalize(device="cpu")
    rigid = newton.solvers.SolverSemiImplicit(model)
    run = Simulation(model, [BodyGel("block", PAD)], [], rigid=rigid, coupling=Coupling.LAGGED)
    forces, heights = [], []
    for _ in range(60):
        run.step()
        forces.append(run.solver.wrenches[block].copy())
        heights.append(float(run.poses()[block, 2]))
    rate = run.state.body_qd.numpy()[block]
    impulse = np.sum(forces[:-1], axis=0)[2] * 1e-3 - 0.05 * 9.81 * 0.06
    assert 0.05 * rate[2] == pytest.approx(impulse, abs=1e-8)
    assert np.mean(forces, axis=0)[2] == pytest.approx(0.05 * 9.81, rel=0.05)  # three periods
    # It swings about its mean height, from where it was let go.
    assert min(heights) == pytest.approx(2 * np.mean(heights) - 5.5e-5, rel=0.1)
    # The diagonals of the pad's tets lean to one side, and are symmetric about that one.
    aside = np.array(forces) / np.max(forces)
    assert np.abs(aside[:, :2]).max() < 0.02
    np.testing.assert_allclose(aside[:, 0], -aside[:, 1], atol=1e-6)


@pytest.mark.slow
def test_a_drive_of_newton_presses_a_gel() -> None:
    """At rest the gel pushes back as hard as newton's drive pushes its link."""
    builder, inertia = newton.ModelBuilder(gravity=(0, 0, 0)), wp.mat33(np.eye(3) * 1e-5)
    builder.add_ground_plane()
    finger = builder.add_link(mass=0.05, inertia=inertia, label="finger")
    down = wp.transform((0, 0, 1e-4), wp.quat(1.0, 0.0, 0.0, 0.0))
    drive = {"target_q": 1e-3, "target_ke": 1000.0, "target_kd": 5.0}
    slide = builder.add_joint_prismatic(-1, finger, parent_xform=down, axis=(0, 0, 1), **drive)
    builder.add_articulation([slide])
    model = builder.finalize(device="cpu")
    rigid = newton.solvers.SolverFeatherstone(model)
    run = Simulation(model, [BodyGel("finger", PAD)], [], rigid=rigid, coupling=Coupling.LAGGED)
    newton.eval_fk(model, model.joint_q, model.joint_qd, run.state)
    control = model.control()
    for _ in range(150):
        run.step(1e-3, control)
    slid = 1e-4 - run.poses()[0, 2]
    force = 1000 * (1e-3 - slid)
    assert force == pytest.approx(0.788, rel=0.01)
    assert run.solver.wrenches[0, 2] == pytest.approx(force, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gels": []}, "at least one gel is needed"),
        ({"touched": ["sphere"]}, "no body 'sphere'; known: left, right, cube"),
        ({"touched": ["left"]}, "body 'left' carries a gel: it cannot be touched, too"),
        ({"coupling": "loose"}, "coupling must be lagged or inside, got 'loose'"),
    ],
)
def test_bad_wishes_are_refused(options: dict[str, object], message: str) -> None:
    given = {"gels": GELS, "touched": ["cube"], **options}
    with pytest.raises(InputError, match=message):
        SolverGel(cube_model(), given.pop("gels"), given.pop("touched"), **given)


LATE = (0.0, 2e-3)
"""How much later jaws of each world close [s]."""


def worlds(count: int, spacing_m: float = 0.0) -> Any:
    builder = newton.ModelBuilder()
    builder.add_ground_plane(height=-0.5)
    builder.replicate(cube_builder(), count, spacing=(0.0, spacing_m, 0.0))
    return builder.finalize(device="cpu")


def squeeze(
    model: Any, late: tuple[float, ...], coupling: Coupling, steps: int, dt: float
) -> tuple[Simulation, np.ndarray]:
    """The simulation after some steps, and wrenches of all steps [step, world, 3, 6]."""
    run = Simulation(model, rigid=free_bodies(model), coupling=coupling)
    places = run.poses().reshape(len(late), 3, 7)[:, :, 1]
    run.solver.reset(run.state)
    wrenches = []
    for step in range(1, steps + 1):
        poses = run.poses().reshape(len(late), 3, 7)
        for world, delay in enumerate(late):
            poses[world, :2] = jaws(max(step * dt - delay, 0.0))
            poses[world, :2, 1] = places[world, :2]
        run.state.body_q.assign(poses.reshape(-1, 7))
        run.step(dt)
        wrenches.append(run.solver.wrenches.reshape(len(late), 3, 6).copy())
    return run, np.array(wrenches)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("coupling", "steps", "dt", "spacing_m"),
    # Lagged worlds stand in one place: at 0.125 m single precision moves the cube by 1e-8 m, which
    # pads of 9 kN/m make 1e-4 N of.
    [
        (Coupling.INSIDE, 8, 1e-3, 0.25),
        pytest.param(Coupling.LAGGED, 40, 1e-4, 0.0, marks=pytest.mark.slow),
    ],
)
def test_worlds_are_as_alone(coupling: Coupling, steps: int, dt: float, spacing_m: float) -> None:
    model = worlds(2, spacing_m)
    assert model.world_count == 2
    run, wrenches = squeeze(model, LATE, coupling, steps, dt)
    assert run.solver.wrenches.shape == (6, 6)
    assert run.solver.gel_model.env_count == 2
    for world, delay in enumerate(LATE):
        alone, forces = squeeze(worlds(1), (delay,), coupling, steps, dt)
        # Steps end at a residual of 1e-6 of the contact forces, which are 1 N.
        np.testing.assert_allclose(wrenches[:, world, :, :3], forces[:, 0, :, :3], atol=2e-5)
        ours, theirs = run.poses()[3 * world : 3 * world + 3], alone.poses()
        ours[:, 1] -= ours[0, 1]
        np.testing.assert_allclose(ours, theirs, atol=1e-7)
        sensor = SensorTactile(run.solver, "left pad", world=world).update()
        single = SensorTactile(alone.solver, "left pad").update()
        np.testing.assert_allclose(sensor.forces, single.forces, atol=2e-5)
        np.testing.assert_allclose(sensor.height_m, single.height_m, atol=1e-8)
        np.testing.assert_allclose(sensor.wrench[:3], single.wrench[:3], atol=2e-5)
    assert abs(wrenches[-1, 0, 0, 0]) > 1.3 * abs(wrenches[-1, 1, 0, 0]) > 0.01
    with pytest.raises(InputError, match="no world 2; there are 0 to 1"):
        SensorTactile(run.solver, "left pad", world=2)


@pytest.mark.thorough
def test_one_world_is_reset_alone() -> None:
    model = worlds(2)
    run, wrenches = squeeze(model, (0.0, 0.0), Coupling.INSIDE, 6, 1e-3)
    solver, poses = run.solver, run.poses()
    assert (np.abs(wrenches[-1, :, 2, 2]) > 1e-4).all()
    assert solver.gel_state is not None
    before = solver.gel_state.positions.numpy().copy()
    poses[3:] = model.state().body_q.numpy()[3:]
    run.state.body_q.assign(poses)
    solver.reset(run.state, wp.array([False, True, False], dtype=wp.bool, device="cpu"))
    after = solver.gel_state.positions.numpy()
    np.testing.assert_array_equal(after[0], before[0])
    assert np.abs(after[1] - before[1]).max() > 1e-4
    assert solver.wrenches[:3].any() and not solver.wrenches[3:].any()
    run.step()
    assert np.abs(solver.wrenches[0, 0]) > 0.1 and np.abs(solver.wrenches[3, 0]) < 0.01


def test_worlds_that_differ_are_refused() -> None:
    def model(*densities: float, outside: bool = False, tilt: float = 0.0) -> Any:
        builder = newton.ModelBuilder()
        if outside:
            builder.add_body(label="outside")
        for k, density in enumerate(densities):
            world = cube_builder(density)
            world.add_ground_plane(height=-0.5 - k * tilt)
            builder.add_world(world)
        return builder.finalize(device="cpu")

    Simulation(model(1200.0, 1200.0))
    for made, message in (
        (model(1200.0, 1300.0), "world 1 differs from world 0 in its body_mass"),
        (model(1200.0, 1200.0, outside=True), "needs the same bodies in each, and none outside"),
        (model(1200.0, 1200.0, tilt=0.1), "planes of world 1 are not where those of world 0 are"),
    ):
        with pytest.raises(InputError, match=message):
            Simulation(made)
