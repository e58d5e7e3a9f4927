# SPDX-License-Identifier: Apache-2.0
"""Rigidity of affine bodies: the energy that keeps it, and free flight with closed joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.ipc.affine.rigidity import predict_affine
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.affine import AffinePotential
from taccel_lab.scene import FixedJoint, KinematicBody, PrismaticJoint, RevoluteJoint
from taccel_lab.solvers import start_step
from taccel_lab.state import initial_state
from tests.ipc.derivatives import Dense, assert_derivatives
from tests.support.turns import random_turns
from tests.verification.affine_scenes import Run, affine_scene, box, turned

SIZES = ((0.1, 0.02, 0.03), (0.04, 0.05, 0.06), (0.03, 0.03, 0.08))
YOUNG = (1e6, 3e7)
VOLUMES = np.prod(SIZES[:2], axis=1)


@cache
def assembly() -> Dense:
    pairs = zip(SIZES, YOUNG, strict=False)
    bodies = [box(str(young), size, young_modulus_pa=young) for size, young in pairs]
    # As many environments as probes of the 24 coordinates need.
    model = replace(affine_scene(bodies), env_count=48).finalize()
    return Dense(model, AffinePotential(model), initial_state(model).positions.numpy()[0])


def strained(seed: int, amount: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    maps = random_turns(rng, 2) @ (np.eye(3) + amount * rng.uniform(-1, 1, size=(2, 3, 3)))
    nodes = rng.normal(size=(2, 4, 3))
    nodes[:, 1:] = assembly().model.affine.lengths.numpy()[:, None, None] * maps.transpose(0, 2, 1)
    return maps, nodes.reshape(8, 3)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), amount=st.floats(1e-3, 1.5))
def test_energy_gradient_hessian_and_its_projection(seed: int, amount: float) -> None:
    found = assembly()
    maps, nodes = strained(seed, amount)
    gram = maps.transpose(0, 2, 1) @ maps - np.eye(3)
    expected = (VOLUMES * YOUNG / 8 * (gram**2).sum(axis=(1, 2))).sum()
    assert found.energy(nodes[None])[0] == pytest.approx(expected, rel=1e-10)
    matrix = found.hessian(nodes, PSD_NONE)
    least = (1e-3 * amount, 0.0)
    assert_derivatives(nodes, 1e-6, found.energy, found.gradient, matrix, least=least)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-14 * np.abs(matrix).max())
    # Clamped eigenvalues, exactly those that numpy finds.
    values, vectors = np.linalg.eigh(matrix)
    projected = (vectors * np.maximum(values, 0)) @ vectors.T
    off = 1e-9 * np.abs(matrix).max()
    np.testing.assert_allclose(found.hessian(nodes, PSD_CLAMP), projected, atol=off)


@given(seed=st.integers(0, 2**31))
def test_rotations_cost_nothing(seed: int) -> None:
    nodes, found = strained(seed, 0.0)[1], assembly()
    size = YOUNG[1] * VOLUMES[1]
    assert found.energy(nodes[None])[0] < 1e-28 * size
    assert np.abs(found.gradient(nodes[None])).max() < 1e-14 * size / 0.02
    # Turns and shifts of each body, 6 of 12, are free; all others are not.
    values = np.linalg.eigvalsh(found.hessian(nodes, PSD_CLAMP))
    assert (np.abs(values[:12]) < 1e-9 * values[-1]).all()
    assert (values[12:] > 1e-4 * values[-1]).all()


# Free flight and joints --------------------------------------------------------------------------

CENTERS = [(0.05, 0, 0), (0.12, 0.01, 0.0), (0.16, 0, 0.05)]
ACTIVE = wp.full(1, 1, dtype=wp.int32)


def three_bodies(*joints, **options) -> Run:
    bodies = [
        box(name, size, center, turned((1, 2, i), 0.3 * i))
        for i, (name, size, center) in enumerate(zip("abc", SIZES, CENTERS, strict=True))
    ]
    return Run(affine_scene(bodies, joints, gravity=(0.0, 0.0, 0.0), **options))


FREE = three_bodies()
TREE = three_bodies(
    # Of mixed direction: the first body of a joint is not always the one nearer to the world.
    PrismaticJoint("c", "b", (0.14, 0, 0.02), (0, 0.3, 1), name="slide"),
    RevoluteJoint("a", None, (0.01, 0, 0), (0, 1, 0.2), name="root"),
    FixedJoint("a", "b", (0.1, 0, 0), name="weld"),
)
FLOATING = three_bodies(
    RevoluteJoint("a", "b", (0.1, 0, 0), (0, 1, 0), name="1"),
    RevoluteJoint("c", "b", (0.14, 0, 0.02), (1, 1, 0), name="2"),
)


def predicted(run: Run, seed: int, amount: float) -> tuple[np.ndarray, wp.array, float]:
    """Random control nodes [3, 4, 3], positions with their prediction, and how far that is off."""
    x = run.state.positions.numpy().copy()
    y = x[0, run.control]
    way = np.random.default_rng(seed).uniform(-1, 1, y.shape)
    y += amount * way * run.lengths.repeat(4)[:, None]
    found, bends = wp.clone(run.state.positions), wp.zeros(1, dtype=wp.float64)
    predict_affine(run.model, ACTIVE, wp.array(x, dtype=wp.vec3d), found, bends)
    return y.reshape(3, 4, 3), found, bends.numpy()[0]


@given(seed=st.integers(0, 2**31), amount=st.floats(0, 0.5))
def test_free_flight_is_the_nearest_rigid_placement(seed: int, amount: float) -> None:
    y, found, bend = predicted(FREE, seed, amount)
    z = found.numpy()[0, FREE.control].reshape(3, 4, 3)
    np.testing.assert_array_equal(z[:, 0], y[:, 0])
    for body in range(3):
        u, _, vt = np.linalg.svd((FREE.masses[body, 1:] * y[body, 1:]).T)
        expected = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        np.testing.assert_allclose(z[body, 1:].T / FREE.lengths[body], expected, atol=1e-11)
    off = np.linalg.norm(z[:, 1:] - y[:, 1:], axis=2).max(axis=1) / FREE.lengths
    assert bend == pytest.approx(off.max(), rel=1e-12, abs=1e-15)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31), amount=st.floats(0, 0.3))
@pytest.mark.parametrize("run", [TREE, FLOATING], ids=["rooted", "floating"])
def test_joints_of_a_prediction_are_closed(run: Run, seed: int, amount: float) -> None:
    joints = run.solver.joints
    assert joints is not None
    _, found, _ = predicted(run, seed, amount)
    joints.begin_step(found, run.state.poses)
    joints.update_multipliers(ACTIVE, found)
    assert joints.violations.numpy()[0] > 1e-3 * amount
    joints.close_predicted(ACTIVE, found)
    joints.update_multipliers(ACTIVE, found)
    assert joints.violations.numpy()[0] < 1e-14
    # Closing turns and shifts; it does not strain.
    maps = found.numpy()[0, run.control].reshape(3, 4, 3)[:, 1:] / run.lengths[:, None, None]
    np.testing.assert_allclose(maps @ maps.transpose(0, 2, 1) - np.eye(3), 0, atol=1e-13)
    joints.reset(np.ones(1, dtype=bool))


def test_joints_to_a_moving_frame_are_closed_there() -> None:
    joint = RevoluteJoint("a", "hand", (0, 0, 0), name="j")
    run = three_bodies(joint, kinematic=[KinematicBody(None, name="hand")])
    joints = run.solver.joints
    assert joints is not None
    pose = np.array([0.1, 0.2, 0.3, *turned((1, 0, 1), 0.4)])
    joints.set_frames(wp.array(pose[None, None], dtype=wp.transformd))
    x = wp.clone(run.state.positions)
    joints.close_predicted(ACTIVE, x)
    y = x.numpy()[0, run.control][:4]
    anchor = y[0] + (y[1:].T / run.lengths[0]) @ [-0.05, 0, 0]
    np.testing.assert_allclose(anchor, pose[:3], atol=1e-15)


def test_it_saves_newton_iterations_and_changes_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    def spin() -> tuple[np.ndarray, int]:
        run = Run(affine_scene([box("b", SIZES[0], initial_spin_rad_s=(1.0, 2.0, 3.0))]))
        return run.y, sum(int(run.step().newton_iterations[0]) for _ in range(5))

    y, few = spin()
    monkeypatch.setattr(start_step, "plan_start", lambda run: None)
    straight, many = spin()
    np.testing.assert_allclose(y, straight, atol=1e-9)
    assert few <= 10 < many
