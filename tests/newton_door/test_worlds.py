# SPDX-License-Identifier: Apache-2.0
"""Several worlds of newton's are environments of one solver, each as it is alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from tests.newton_door.squeezed_cube import (
    CONFIG,
    PAD,
    BodyGel,
    Coupling,
    SolverGel,
    cube_builder,
    jaws,
    newton,
)

SensorTactile = pytest.importorskip("taccel_lab.newton_door.sensor_tactile").SensorTactile
GELS = [BodyGel(side, PAD, name=f"{side} pad") for side in ("left", "right")]
LATE = (0.0, 2e-3)
"""How much later jaws of each world close [s]."""


def worlds(count: int, spacing_m: float = 0.0) -> Any:
    """Side by side along y."""
    builder = newton.ModelBuilder()
    builder.add_ground_plane(height=-0.5)
    builder.replicate(cube_builder(), count, spacing=(0.0, spacing_m, 0.0))
    return builder.finalize(device="cpu")


def solver_of(model: Any, coupling: Coupling) -> SolverGel:
    rigid = newton.solvers.SolverSemiImplicit(model, angular_damping=0.0)
    return SolverGel(model, GELS, ["cube"], rigid=rigid, coupling=coupling, config=CONFIG)


def squeeze(
    model: Any, late: tuple[float, ...], coupling: Coupling, steps: int, dt: float
) -> tuple[SolverGel, Any, np.ndarray]:
    """The solver, the state after some steps, and wrenches of all steps [step, world, 3, 6]."""
    solver, states = solver_of(model, coupling), [model.state(), model.state()]
    places = states[0].body_q.numpy().reshape(len(late), 3, 7)[:, :, 1].copy()
    solver.reset(states[0])
    wrenches = []
    for step in range(1, steps + 1):
        poses = states[0].body_q.numpy().reshape(len(late), 3, 7)
        for world, delay in enumerate(late):
            poses[world, :2] = jaws(max(step * dt - delay, 0.0))
            poses[world, :2, 1] = places[world, :2]
        states[0].body_q.assign(poses.reshape(-1, 7))
        solver.step(states[0], states[1], None, None, dt)
        wrenches.append(solver.wrenches.reshape(len(late), 3, 6).copy())
        states = states[::-1]
    return solver, states[0], np.array(wrenches)


@pytest.mark.parametrize(
    ("coupling", "steps", "dt", "spacing_m"),
    # Lagged worlds stand in one place: at 0.125 m single precision moves the cube by 1e-8 m, which
    # pads of 9 kN/m make 1e-4 N of.
    [(Coupling.INSIDE, 8, 1e-3, 0.25), (Coupling.LAGGED, 40, 1e-4, 0.0)],
)
def test_worlds_do_what_they_do_alone(
    coupling: Coupling, steps: int, dt: float, spacing_m: float
) -> None:
    model = worlds(2, spacing_m)
    assert model.world_count == 2
    solver, state, wrenches = squeeze(model, LATE, coupling, steps, dt)
    assert solver.wrenches.shape == (6, 6)
    assert solver.gel_model.env_count == 2
    bodies = state.body_q.numpy().reshape(2, 3, 7)
    for world, delay in enumerate(LATE):
        alone, own, forces = squeeze(worlds(1), (delay,), coupling, steps, dt)
        # Steps end at a residual of 1e-6 of the contact forces, which are 1 N.
        np.testing.assert_allclose(wrenches[:, world, :, :3], forces[:, 0, :, :3], atol=2e-5)
        ours, theirs = bodies[world].copy(), own.body_q.numpy().reshape(3, 7)
        ours[:, 1] -= ours[0, 1]
        np.testing.assert_allclose(ours, theirs, atol=1e-7)
        sensor = SensorTactile(solver, "left pad", world=world).update()
        single = SensorTactile(alone, "left pad").update()
        np.testing.assert_allclose(sensor.forces, single.forces, atol=2e-5)
        np.testing.assert_allclose(sensor.height_m, single.height_m, atol=1e-8)
        np.testing.assert_allclose(sensor.wrench[:3], single.wrench[:3], atol=2e-5)
    assert abs(wrenches[-1, 0, 0, 0]) > 1.3 * abs(wrenches[-1, 1, 0, 0]) > 0.01
    with pytest.raises(InputError, match="no world 2; there are 0 to 1"):
        SensorTactile(solver, "left pad", world=2)


def test_one_world_is_reset_alone() -> None:
    model = worlds(2)
    solver, state, wrenches = squeeze(model, (0.0, 0.0), Coupling.INSIDE, 6, 1e-3)
    assert (np.abs(wrenches[-1, :, 2, 2]) > 1e-4).all()
    assert solver.gel_state is not None
    before = solver.gel_state.positions.numpy().copy()
    start = model.state().body_q.numpy().reshape(2, 3, 7)
    poses = state.body_q.numpy().reshape(2, 3, 7)
    poses[1] = start[1]
    state.body_q.assign(poses.reshape(-1, 7))
    solver.reset(state, wp.array([False, True, False], dtype=wp.bool, device="cpu"))
    after = solver.gel_state.positions.numpy()
    np.testing.assert_array_equal(after[0], before[0])
    assert np.abs(after[1] - before[1]).max() > 1e-4
    assert solver.wrenches.reshape(2, 3, 6)[0].any()
    assert not solver.wrenches.reshape(2, 3, 6)[1].any()
    other = model.state()
    solver.step(state, other, None, None, 1e-3)
    assert np.abs(solver.wrenches.reshape(2, 3, 6)[0, 0, 0]) > 0.1
    assert np.abs(solver.wrenches.reshape(2, 3, 6)[1, 0, 0]) < 0.01


def test_worlds_that_differ_are_refused() -> None:
    def model(*densities: float, outside: bool = False, tilt: float = 0.0) -> Any:
        builder = newton.ModelBuilder()
        if outside:
            builder.add_body(label="outside")
        for k, density in enumerate(densities):
            world = cube_builder(density)
            world.add_ground_plane(height=-0.5 - k * tilt)  # type: ignore[attr-defined]
            builder.add_world(world)
        return builder.finalize(device="cpu")

    solver_of(model(1200.0, 1200.0), Coupling.INSIDE)
    for made, message in (
        (model(1200.0, 1300.0), "world 1 differs from world 0 in its body_mass"),
        (model(1200.0, 1200.0, outside=True), "needs the same bodies in each, and none outside"),
        (model(1200.0, 1200.0, tilt=0.1), "planes of world 1 are not where those of world 0 are"),
    ):
        with pytest.raises(InputError, match=message):
            solver_of(made, Coupling.INSIDE)
