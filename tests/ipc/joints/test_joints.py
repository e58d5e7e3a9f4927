# SPDX-License-Identifier: Apache-2.0
"""Joints as a potential: derivatives, what each kind leaves free, coordinates, wrenches."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.joints.rows import COORDINATE_ROW
from taccel_lab.ipc.potentials.joints import JointPotential
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import (
    AffineBody,
    FixedJoint,
    Joint,
    KinematicBody,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    Surface,
    TimeStepping,
    box_mesh,
)
from taccel_lab.state import initial_state
from tests.ipc.batch import unit
from tests.ipc.derivatives import Dense, assert_semidefinite, differences, empty_system

KINDS = {"fixed": FixedJoint, "revolute": RevoluteJoint, "prismatic": PrismaticJoint}
DT = 0.01
ANCHOR, AXIS = np.array([0.11, 0.02, -0.03]), unit(np.array([0.3, -0.5, 0.8]))
POSE_A = np.array([0.05, 0, 0, 0, 0, 0, 1.0])
POSE_B = np.array([0.15, 0.01, -0.02, *unit(np.array([0.5, -0.1, 0.7, 0.5]))])
POSE_K = np.array([0.2, -0.1, 0.3, *unit(np.array([0.1, 0.2, -0.3, 0.9]))])
STILL, NOWHERE = np.array([0, 0, 0, 1.0]), np.zeros(3)
every_kind = pytest.mark.parametrize("kind", KINDS)
every_second = pytest.mark.parametrize("second", (None, "b", "k"))
PERTURBED = {"seed": st.integers(0, 2**31), "amount": st.floats(1e-3, 0.5)}


def quaternion(axis: np.ndarray, angle: float) -> np.ndarray:
    return np.append(np.sin(angle / 2) * axis / np.linalg.norm(axis), np.cos(angle / 2))


def body(name: str, at: np.ndarray, **options: Any) -> AffineBody:
    size = {"a": (0.1, 0.02, 0.03), "b": (0.04, 0.05, 0.06)}[name]
    return AffineBody(box_mesh(size), name=name, initial_pose=at, **options)


def scene(joint: Joint, *bodies: AffineBody, env_count: int) -> Scene:
    time = TimeStepping(quasi_static=False, dt_s=DT)
    frame = KinematicBody(None, name="k")
    return Scene((), frame, env_count, time, affine_bodies=bodies, joints=[joint])


class Rig(Dense):
    """One joint between body a and something else, with many environments to probe in."""

    def __init__(self, kind: str, second: str | None, env_count: int = 48, **options: Any) -> None:
        pose = POSE_K if second == "k" else None
        joint = KINDS[kind]("a", second, ANCHOR, AXIS, second_pose=pose, name="j", **options)
        bodies = (body("a", POSE_A), body("b", POSE_B))
        model = scene(joint, *bodies, env_count=env_count).finalize()
        self.poses = wp.array(np.tile(POSE_K, (env_count, 1, 1)), dtype=wp.transformd)
        state = initial_state(model, self.poses.numpy().reshape(env_count, 1, 7))
        super().__init__(model, JointPotential(model), state.positions.numpy()[0])
        self.joints: JointPotential = self.potential
        self.start = self.base[self.free]
        self.begin(self.start)

    def everywhere(self, free: np.ndarray) -> wp.array:
        return self.positions(np.repeat(free[None], self.model.env_count, axis=0))

    def begin(self, free: np.ndarray) -> None:
        self.joints.begin_step(self.everywhere(free), self.poses)

    def set_multipliers(self, values: np.ndarray | float) -> None:
        self.joints.state.multipliers.assign(values + 0 * self.joints.state.multipliers.numpy())

    def violation(self, free: np.ndarray) -> float:
        """That which multipliers have taken over."""
        self.joints.update_multipliers(self.active, self.everywhere(free))
        return self.joints.violations.numpy()[0]

    def rows(self, free: np.ndarray) -> np.ndarray:
        found = []
        for n, x in self.batches(free):
            self.joints._evaluate(self.active, x, derivatives=False)
            found.append(self.joints._values.numpy()[:n, 0])
        return np.concatenate(found)

    def perturbed(self, seed: int, amount: float) -> np.ndarray:
        return self.start + amount * np.random.default_rng(seed).uniform(-0.05, 0.05, size=(8, 3))

    def placed(self, shift: np.ndarray, turn: np.ndarray = STILL) -> np.ndarray:
        """Body a moved relative to its initial pose: turned about the anchor, then shifted."""
        nodes = self.start.copy()
        nodes[0] = rotate(turn, nodes[0] - ANCHOR) + ANCHOR + shift
        nodes[1:4] = rotate(turn, nodes[1:4])
        return nodes

    def assert_gradient(self, nodes: np.ndarray, step: float, within: float) -> np.ndarray:
        found = self.gradient(nodes[None])[0]
        scale = np.abs(found).max()
        assert scale > 1.0
        slope = differences(self.energy, nodes, step).reshape(8, 3)
        np.testing.assert_allclose(found, slope, atol=within * scale)
        return found


rig = cache(Rig)


@settings(max_examples=5)
@given(**PERTURBED)
@every_second
@every_kind
def test_gradient_and_the_matrix_of_gauss_and_newton(
    kind: str, second: str | None, seed: int, amount: float
) -> None:
    r = rig(kind, second)
    multipliers = np.random.default_rng(seed).normal(size=COORDINATE_ROW + 1)
    multipliers[COORDINATE_ROW] = 0.0
    r.set_multipliers(multipliers)
    nodes = r.perturbed(seed, amount)
    found = r.assert_gradient(nodes, 1e-7, 1e-6)
    if second != "b":
        np.testing.assert_array_equal(found[4:], 0)
    r.set_multipliers(0.0)
    by_rows = differences(r.rows, nodes, 1e-7)[:, :COORDINATE_ROW]
    curvatures = np.repeat(r.joints._table.penalties.numpy()[0, :2] / DT**2, 3)
    expected = (by_rows * curvatures) @ by_rows.T
    for mode in (PSD_NONE, PSD_CLAMP):
        matrix = r.hessian(nodes, mode)
        np.testing.assert_allclose(matrix, expected, atol=1e-6 * np.abs(expected).max())
        assert_semidefinite(matrix)
    values = np.linalg.eigvalsh(r.hessian(r.start, PSD_CLAMP))
    assert (values > 1e-9 * values[-1]).sum() == {"fixed": 6, "revolute": 5, "prismatic": 5}[kind]


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("way", [-0.5, -0.05, 0.0, 0.05, 0.5])
def test_gradient_with_drive_and_limits(kind: str, way: float) -> None:
    if kind == "revolute":
        limits, shift, turn = {"limits_deg": (-20, 5)}, NOWHERE, quaternion(AXIS, way)
    else:
        limits, shift, turn = {"limits_mm": (-4, 1)}, way * 0.02 * AXIS, STILL
    r = Rig(kind, "b", drive=PositionDrive(50.0, 2.0, target=0.3), **limits)
    r.set_multipliers(np.array([1, -2, 3, 0.5, 0.3, 2, 1.0]))
    nodes = r.placed(shift, turn) + 1e-4 * np.random.default_rng(1).uniform(-1, 1, size=(8, 3))
    # Rates count from the start of the step.
    r.begin(nodes + 1e-5)
    r.assert_gradient(nodes, 1e-8, 3e-6)
    assert_semidefinite(r.hessian(nodes, PSD_CLAMP))


@given(angle=st.floats(-3.1, 3.1), tilt=st.floats(0.01, 0.2), way=st.floats(-0.2, 0.2))
@every_second
@every_kind
def test_only_the_motion_of_the_joint_is_free(
    kind: str, second: str | None, angle: float, tilt: float, way: float
) -> None:
    r = rig(kind, second)
    r.begin(r.start)
    across = unit(np.cross(AXIS, [1, 0, 0]))
    turned, tilted = (quaternion(*turn) for turn in ((AXIS, angle), (across, tilt)))
    moves = [(NOWHERE,), (NOWHERE, turned), (way * AXIS,), (tilt * across,), (NOWHERE, tilted)]
    rows = r.rows(np.stack([r.placed(*move) for move in moves]))
    held, coordinates = np.linalg.norm(rows[:, :COORDINATE_ROW], axis=1), rows[:, COORDINATE_ROW]
    size = r.joints._table.sizes.numpy()[0]
    # From angles of a few degrees up to a turn: sine and half of it.
    assert held[0] < 1e-15 and held[3] == pytest.approx(tilt, rel=1e-9)
    assert held[4] == pytest.approx(size * np.sin(tilt), rel=1e-9)
    if kind == "revolute":
        assert held[1] < 1e-15 and coordinates[1] == pytest.approx(angle, abs=1e-12)
    else:
        assert held[1] == pytest.approx(size * abs(np.sin(angle)), rel=1e-9, abs=1e-15)
    if kind == "prismatic":
        assert held[2] < 1e-15 and coordinates[2] == pytest.approx(way, abs=1e-14)
    else:
        assert held[2] == pytest.approx(abs(way), rel=1e-9, abs=1e-15)


def test_targets_differ_by_environment_and_can_be_set() -> None:
    r = Rig("revolute", None, 2, drive=PositionDrive(10.0, target=np.array([0.0, 0.2])))

    def efforts() -> np.ndarray:
        r.joints.end_step(r.active, r.everywhere(r.start))
        return r.joints.efforts.numpy()[:, 0]

    np.testing.assert_allclose(efforts(), [0, 2.0], atol=1e-12)
    r.joints.state.targets.assign(np.array([[0.3], [-0.1]]))
    r.begin(r.start)
    np.testing.assert_allclose(efforts(), [3.0, -1.0], atol=1e-12)


def test_multipliers_take_over_the_force() -> None:
    r = Rig("revolute", None, 1)
    off = r.placed(np.array([1e-6, 0, 0]), quaternion(np.array([0, 1.0, 0]), 1e-6))

    def force(nodes: np.ndarray) -> np.ndarray:
        return r.gradient(nodes[None])[0]

    before = force(off)
    assert r.violation(off) == pytest.approx(1e-6, rel=1e-6)
    after = force(r.start)
    np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-5 * np.abs(before).max())
    # A violation below the tolerance changes nothing.
    assert r.violation(r.start) < 1e-15
    np.testing.assert_array_equal(force(r.start), after)
    r.joints.restore(r.active)  # As where a step failed.
    np.testing.assert_allclose(force(r.start), 0, atol=1e-6)


def test_a_limit_pushes_and_never_pulls() -> None:
    r = Rig("prismatic", None, 1, limits_mm=(-2.0, 3.0))

    def force(way: float) -> float:
        return float(r.gradient(r.placed(way * AXIS)[None])[0, 0] @ AXIS)

    # Rounding of the frames is all there is.
    assert abs(force(2.99e-3)) < 1e-20 and abs(force(-1.99e-3)) < 1e-20
    assert force(3.01e-3) > 0 > force(-2.01e-3)
    assert r.violation(r.placed(3.01e-3 * AXIS)) == pytest.approx(1e-5)
    held = force(3e-3)
    assert held > 0
    # Off the limit, the multiplier's force is gone, and not converged until it is forgotten.
    assert abs(force(2.98e-3)) < 1e-20 and r.violation(r.placed(2.98e-3 * AXIS)) > 9e-6
    assert force(3e-3) == pytest.approx(0, abs=1e-9 * held)


@every_kind
def test_motion_of_a_kinematic_frame_reaches_the_right_hand_side(kind: str) -> None:
    r, step = Rig(kind, "k", 1), 1e-7
    goal = POSE_K + step * np.array([1, -2, 0.5, 0.3, 0.2, -0.4, 0.1])
    goal[3:] = unit(goal[3:])
    goals = wp.array(goal[None, None], dtype=wp.transformd)
    nodes, system = r.start[None], empty_system(r.model)
    r.joints.set_frames(r.poses, goals)
    r.joints.add_hessian(r.active, r.positions(nodes), system)
    still = r.gradient(nodes)[0]
    r.joints.set_frames(goals)
    change = r.gradient(nodes)[0] - still
    assert np.abs(change).max() > 1e-3
    off = 1e-5 * np.abs(still + change).max()
    np.testing.assert_allclose(system.rhs.numpy()[0], -change, atol=off)


def test_absent_bodies_have_no_joint() -> None:
    here = body("a", POSE_A, surface=Surface(environments=(1,)))
    model = scene(RevoluteJoint("a", None, ANCHOR, AXIS), here, env_count=2).finalize()
    state = initial_state(model)
    dense = Dense(model, JointPotential(model), state.positions.numpy()[0])
    dense.potential.begin_step(state.positions, state.poses)
    forces = dense.gradient(np.repeat(dense.base[dense.free][None] + 1e-3, 2, axis=0))
    np.testing.assert_array_equal(forces[0], 0)
    assert np.abs(forces[1]).max() > 1


def test_each_environment_has_its_own_initial_configuration() -> None:
    shift = np.array([0.3, -0.2, 0.1])
    turn = quaternion(np.array([1.0, 2.0, 3.0]), 1.2)
    poses = np.stack([POSE_A, np.concatenate([rotate(turn, POSE_A[:3]) + shift, turn])])
    anchors = np.stack([ANCHOR, rotate(turn, ANCHOR) + shift])
    joint = RevoluteJoint("a", None, anchors, np.stack([AXIS, rotate(turn, AXIS)]))
    model = scene(joint, body("a", poses), env_count=2).finalize()
    state, joints = initial_state(model), JointPotential(model)
    active = wp.full(2, 1, dtype=wp.int32)
    joints.begin_step(state.positions, state.poses)
    joints.update_multipliers(active, state.positions)
    assert joints.violations.numpy().max() < 1e-15
    # The same swing in both has the same angle and the same forces in their own frames.
    x, swing = state.positions.numpy().copy(), quaternion(AXIS, 0.4)
    x[0, 0] = rotate(swing, x[0, 0] - ANCHOR) + ANCHOR + 1e-6
    x[0, 1:4] = rotate(swing, x[0, 1:4])
    x[1, 0] = rotate(turn, x[0, 0]) + shift
    x[1, 1:4] = rotate(turn, x[0, 1:4])
    moved = wp.array(x, dtype=wp.vec3d)
    joints.add_gradient(active, moved, gradient := wp.zeros_like(moved))
    forces = gradient.numpy()[:, :4]
    assert np.abs(forces).max() > 0.1
    np.testing.assert_allclose(forces[1], rotate(turn, forces[0]), atol=1e-7 * np.abs(forces).max())
    joints.end_step(active, moved)
    np.testing.assert_allclose(joints.coordinates.numpy()[:, 0], 0.4, atol=1e-12)
