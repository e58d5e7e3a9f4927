# SPDX-License-Identifier: Apache-2.0
"""Gels in newton's simulations: forces in balance, bodies where our own solve has them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from tests.newton_door.squeezed_cube import (
    CONFIG,
    MASS,
    PAD,
    BodyGel,
    Coupling,
    SolverGel,
    coupled,
    cube_model,
    monolithic,
    newton,
)

GELS = [BodyGel(side, PAD, name=f"{side} pad") for side in ("left", "right")]


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


def test_a_lagged_cube_comes_to_our_own_solve_with_the_step() -> None:
    """The wrench that acts is that of the step before: shorter steps come closer."""
    errors = []
    for dt in (1e-4, 5e-5):
        ours, theirs = monolithic(dt, 5e-3), coupled(dt, Coupling.LAGGED, 5e-3)
        np.testing.assert_allclose(theirs.forces + theirs.on_gels.sum(axis=1), 0, atol=1e-12)
        errors.append(np.abs(theirs.positions - ours.positions).max())
        late = theirs.imbalance()[1:] + dt * np.diff(theirs.forces, axis=0)
        # What moved the cube in a step is the wrench of the one before, to FP32 velocities.
        assert np.abs(late).max() < 1e-6 * MASS
    assert errors[1] < 0.7 * errors[0] < 5e-6


def test_what_others_do_to_a_body_inside_is_followed() -> None:
    """A push by body_f, and a body that is put elsewhere between steps."""
    model = cube_model()
    solver = SolverGel(model, GELS, ["cube"], config=CONFIG)
    states = [model.state(), model.state()]  # type: ignore[attr-defined]
    poses, rates = states[0].body_q.numpy().copy(), states[0].body_qd.numpy().copy()
    turn = np.array([0.0, np.sin(0.15), 0.0, np.cos(0.15)])
    poses[2], rates[2] = [0, 0, 0.05, *turn], [0.1, 0, 0.2, 0, 3.0, 0]
    push = np.zeros((3, 6), dtype=np.float32)
    push[2] = [0, 2 * MASS, MASS * 9.81, 0, 0, 0]
    dt = 1e-3
    for step in range(10):
        if step == 0:
            states[0].body_q.assign(poses)
            states[0].body_qd.assign(rates)
        states[0].body_f.assign(push)
        solver.step(states[0], states[1], None, None, dt)
        states = states[::-1]
    after = states[0].body_q.numpy()[2].astype(np.float64)
    assert states[0].body_qd.numpy()[2, :3] == pytest.approx([0.1, 2 * 10 * dt, 0.2], abs=1e-6)
    # Implicit Euler: a dt^2 n (n + 1) / 2.
    assert after[:3] == pytest.approx([1e-3, 2 * dt**2 * 55, 0.052], abs=1e-7)
    # It turns about its own axis at 3 rad/s, less what implicit Euler loses.
    assert 2 * np.arctan2(after[4], after[6]) == pytest.approx(0.3 + 0.03, abs=2e-4)
    assert solver.wrenches[2] == pytest.approx(np.zeros(6), abs=1e-12)
    assert states[0].joint_q.numpy()[-7:] == pytest.approx(after, abs=1e-7)


def test_a_body_bounces_on_its_gel() -> None:
    """A free block of 50 g whose gel stands on newton's ground plane, which newton's solver,
    without contacts, does not know: only the wrench of the gel holds it, around 0.1 mm deep."""
    builder = newton.ModelBuilder()
    builder.add_ground_plane()
    down = wp.transform((0, 0, 5.5e-5), wp.quat(1.0, 0.0, 0.0, 0.0))
    inertia = wp.mat33(np.eye(3) * 1e-5)
    block = builder.add_body(xform=down, mass=0.05, inertia=inertia, label="block")
    model = builder.finalize(device="cpu")
    solver = SolverGel(
        model,
        [BodyGel("block", PAD)],
        [],
        rigid=newton.solvers.SolverSemiImplicit(model),
        coupling=Coupling.LAGGED,
        config=CONFIG,
    )
    states = [model.state(), model.state()]
    forces, heights = [], []
    for _ in range(60):
        solver.step(states[0], states[1], None, None, 1e-3)
        states = states[::-1]
        forces.append(solver.wrenches[block].copy())
        heights.append(float(states[0].body_q.numpy()[block, 2]))
    rate = states[0].body_qd.numpy()[block]
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
    """A link on a slide, pushed by newton's drive through the ground: at rest the gel pushes back
    as hard as the drive. Slow where newton's kernels are compiled."""
    builder = newton.ModelBuilder(gravity=(0, 0, 0))
    builder.add_ground_plane()
    inertia = wp.mat33(np.eye(3) * 1e-5)
    finger = builder.add_link(mass=0.05, inertia=inertia, label="finger")
    down = wp.transform((0, 0, 1e-4), wp.quat(1.0, 0.0, 0.0, 0.0))
    drive = {"target_q": 1e-3, "target_ke": 1000.0, "target_kd": 5.0}
    slide = builder.add_joint_prismatic(-1, finger, parent_xform=down, axis=(0, 0, 1), **drive)
    builder.add_articulation([slide])
    model = builder.finalize(device="cpu")
    rigid = newton.solvers.SolverFeatherstone(model)
    options = {"rigid": rigid, "coupling": Coupling.LAGGED, "config": CONFIG}
    solver = SolverGel(model, [BodyGel("finger", PAD)], [], **options)
    states, control = [model.state(), model.state()], model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, states[0])
    for _ in range(150):
        solver.step(states[0], states[1], control, None, 1e-3)
        states = states[::-1]
    slid = 1e-4 - states[0].body_q.numpy()[0, 2]
    force = 1000 * (1e-3 - slid)
    assert force == pytest.approx(0.788, rel=0.01)
    assert solver.wrenches[0, 2] == pytest.approx(force, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gels": []}, "at least one gel is needed"),
        ({"touched": ["sphere"]}, "no body 'sphere'; there are left, right, cube"),
        ({"touched": ["left"]}, "body 'left' carries a gel: it cannot be touched, too"),
        ({"coupling": "loose"}, "coupling must be lagged or inside, got 'loose'"),
    ],
)
def test_bad_wishes_are_refused(options: dict[str, object], message: str) -> None:
    given = {"gels": GELS, "touched": ["cube"], **options}
    with pytest.raises(InputError, match=message):
        SolverGel(cube_model(), given.pop("gels"), given.pop("touched"), **given)
