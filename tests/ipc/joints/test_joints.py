# SPDX-License-Identifier: Apache-2.0
"""Joints as a potential: derivatives, what each kind leaves free, coordinates, wrenches."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.ipc.dense_system import Dense, differences, empty_system

from taccel_lab.bodies.bodies import AffineBody, KinematicBody, Surface
from taccel_lab.bodies.joints import (
    FixedJoint,
    Joint,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
)
from taccel_lab.bodies.primitives import box_mesh
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.joints.rows import COORDINATE_ROW
from taccel_lab.ipc.potentials.joints import JointPotential
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import Scene, TimeStepping
from taccel_lab.state import initial_state

KINDS: dict[str, type[Joint]] = {
    "fixed": FixedJoint,
    "revolute": RevoluteJoint,
    "prismatic": PrismaticJoint,
}
SECONDS = (None, "b", "k")
DT = 0.01
ANCHOR, AXIS = np.array([0.11, 0.02, -0.03]), np.array([0.3, -0.5, 0.8])
AXIS = AXIS / np.linalg.norm(AXIS)
POSE_A = np.array([0.05, 0, 0, 0, 0, 0, 1.0])
POSE_B = np.array([0.15, 0.01, -0.02, 0.5, -0.1, 0.7, 0.5])
POSE_B[3:] /= np.linalg.norm(POSE_B[3:])
POSE_K = np.array([0.2, -0.1, 0.3, 0.1, 0.2, -0.3, 0.9])
POSE_K[3:] /= np.linalg.norm(POSE_K[3:])


def quaternion(axis: np.ndarray, angle: float) -> np.ndarray:
    return np.append(np.sin(angle / 2) * axis / np.linalg.norm(axis), np.cos(angle / 2))


class Rig(Dense):
    """One joint between body a and something else, with many environments to probe in."""

    def __init__(self, joint: Joint, env_count: int = 48) -> None:
        scene = Scene(
            affine_bodies=[
                AffineBody(box_mesh((0.1, 0.02, 0.03)), name="a", initial_pose=POSE_A),
                AffineBody(box_mesh((0.04, 0.05, 0.06)), name="b", initial_pose=POSE_B),
            ],
            kinematic_bodies=[KinematicBody(None, name="k")],
            joints=[joint],
            env_count=env_count,
            time=TimeStepping(quasi_static=False, dt_s=DT),
        )
        model = scene.finalize()
        self.poses = wp.array(np.tile(POSE_K, (env_count, 1, 1)), dtype=wp.transformd)
        state = initial_state(model, self.poses.numpy().reshape(env_count, 1, 7))
        super().__init__(model, JointPotential(model), state.positions.numpy()[0])
        self.begin(self.base[self.free])

    @property
    def joints(self) -> JointPotential:
        return self.potential

    @property
    def start(self) -> np.ndarray:
        """Free nodes of the initial configuration, [8, 3]."""
        return self.base[self.free]

    def begin(self, free: np.ndarray) -> None:
        everywhere = np.repeat(free[None], self.model.env_count, axis=0)
        self.joints.begin_step(self.positions(everywhere), self.poses)

    def set_multipliers(self, values: np.ndarray | float) -> None:
        self.joints.state.multipliers.assign(values + 0 * self.joints.state.multipliers.numpy())

    def rows(self, free: np.ndarray) -> np.ndarray:
        """Values of the rows, [count, ROW_COUNT]."""
        found = []
        for b in self._batches(free):
            self.joints._evaluate(self.active, self.positions(b), derivatives=False)
            found.append(self.joints._values.numpy()[: len(b), 0])
        return np.concatenate(found)

    def curvatures(self) -> np.ndarray:
        """Penalties of rows 0..5 [N/m]."""
        return np.repeat(self.joints._table.penalties.numpy()[0, :2] / DT**2, 3)


def made(kind: str, second: str | None, **options: object) -> Joint:
    pose = POSE_K if second == "k" else None
    return KINDS[kind]("a", second, ANCHOR, AXIS, second_pose=pose, name="j", **options)


@cache
def rig(kind: str, second: str | None) -> Rig:
    return Rig(made(kind, second))


@cache
def driven_rig(kind: str) -> Rig:
    limits = {"limits_deg": (-20, 5)} if kind == "revolute" else {"limits_mm": (-4, 1)}
    return Rig(made(kind, "b", drive=PositionDrive(50.0, 2.0, target=0.3), **limits))


def perturbed(r: Rig, seed: int, amount: float) -> np.ndarray:
    return r.start + amount * np.random.default_rng(seed).uniform(-0.05, 0.05, size=(8, 3))


def placed(r: Rig, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Body a moved relative to its initial pose: turned about the anchor, then shifted."""
    nodes = r.start.copy()
    nodes[0] = rotate(turn, nodes[0] - ANCHOR) + ANCHOR + shift
    nodes[1:4] = rotate(turn, nodes[1:4])
    return nodes


# Derivatives ----------------------------------------------------------------------------------


@settings(max_examples=5)
@given(seed=st.integers(0, 2**31), amount=st.floats(1e-3, 0.5))
@pytest.mark.parametrize("second", SECONDS)
@pytest.mark.parametrize("kind", list(KINDS))
def test_gradient(kind: str, second: str | None, seed: int, amount: float) -> None:
    r = rig(kind, second)
    rng = np.random.default_rng(seed)
    multipliers = rng.normal(size=COORDINATE_ROW + 1)
    multipliers[COORDINATE_ROW] = 0.0
    r.set_multipliers(multipliers)
    nodes = perturbed(r, seed, amount)
    found = r.gradient(nodes[None])[0]
    scale = np.abs(found).max()
    assert scale > 1.0
    slope = differences(r.energy, nodes, 1e-7).reshape(8, 3)
    np.testing.assert_allclose(found, slope, atol=1e-6 * scale)
    if second != "b":
        np.testing.assert_array_equal(found[4:], 0)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**31), amount=st.floats(1e-3, 0.5))
@pytest.mark.parametrize("second", SECONDS)
@pytest.mark.parametrize("kind", list(KINDS))
def test_matrix_is_that_of_gauss_and_newton(
    kind: str, second: str | None, seed: int, amount: float
) -> None:
    r = rig(kind, second)
    r.set_multipliers(0.0)
    nodes = perturbed(r, seed, amount)
    by_rows = differences(r.rows, nodes, 1e-7)[:, :COORDINATE_ROW]
    expected = (by_rows * r.curvatures()) @ by_rows.T
    for mode in (PSD_NONE, PSD_CLAMP):
        found = r.hessian(nodes, mode)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
        values = np.linalg.eigvalsh(found)
        assert values[0] > -1e-12 * values[-1]
    values = np.linalg.eigvalsh(r.hessian(r.start, PSD_CLAMP))
    assert (values > 1e-9 * values[-1]).sum() == {"fixed": 6, "revolute": 5, "prismatic": 5}[kind]


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("way", [-0.5, -0.05, 0.0, 0.05, 0.5])
def test_gradient_with_drive_and_limits(kind: str, way: float) -> None:
    """Also beyond the limits, on either side."""
    r = driven_rig(kind)
    r.set_multipliers(np.array([1, -2, 3, 0.5, 0.3, 2, 1.0]))
    scale = {"revolute": 1.0, "prismatic": 0.02}[kind]
    turn, shift = np.array([0, 0, 0, 1.0]), way * scale * AXIS
    if kind == "revolute":
        turn, shift = quaternion(AXIS, way), np.zeros(3)
    nodes = placed(r, shift, turn) + 1e-4 * np.random.default_rng(1).uniform(-1, 1, size=(8, 3))
    # Rates count from the start of the step.
    r.begin(nodes + 1e-5)
    found = r.gradient(nodes[None])[0]
    slope = differences(r.energy, nodes, 1e-8).reshape(8, 3)
    size = np.abs(found).max()
    assert size > 1
    np.testing.assert_allclose(found, slope, atol=3e-6 * size)
    values = np.linalg.eigvalsh(r.hessian(nodes, PSD_CLAMP))
    assert values[0] > -1e-12 * values[-1]


# What is free, and what is held ----------------------------------------------------------------


@given(angle=st.floats(-3.1, 3.1), tilt=st.floats(0.01, 0.2), way=st.floats(-0.2, 0.2))
@pytest.mark.parametrize("second", SECONDS)
@pytest.mark.parametrize("kind", list(KINDS))
def test_only_the_motion_of_the_joint_is_free(
    kind: str, second: str | None, angle: float, tilt: float, way: float
) -> None:
    r = rig(kind, second)
    r.begin(r.start)
    across = np.cross(AXIS, [1, 0, 0])
    across /= np.linalg.norm(across)
    still, none = np.array([0, 0, 0, 1.0]), np.zeros(3)
    turned = placed(r, none, quaternion(AXIS, angle))
    slid = placed(r, way * AXIS, still)
    rows = r.rows(
        np.stack(
            [
                r.start,
                turned,
                slid,
                placed(r, tilt * across, still),
                placed(r, none, quaternion(across, tilt)),
            ]
        )
    )
    held = np.linalg.norm(rows[:, :COORDINATE_ROW], axis=1)
    size = r.joints._table.sizes.numpy()[0]
    # From angles of a few degrees up to a turn: sine and half of it.
    assert held[0] < 1e-15
    assert held[3] == pytest.approx(tilt, rel=1e-9)
    assert held[4] == pytest.approx(size * np.sin(tilt), rel=1e-9)
    if kind == "revolute":
        assert held[1] < 1e-15
        assert rows[1, COORDINATE_ROW] == pytest.approx(angle, abs=1e-12)
        assert held[2] == pytest.approx(abs(way), rel=1e-9, abs=1e-15)
    else:
        assert held[1] == pytest.approx(size * abs(np.sin(angle)), rel=1e-9, abs=1e-15)
    if kind == "prismatic":
        assert held[2] < 1e-15
        assert rows[2, COORDINATE_ROW] == pytest.approx(way, abs=1e-14)
    if kind == "fixed":
        assert held[2] == pytest.approx(abs(way), rel=1e-9, abs=1e-15)


# Drives, limits, multipliers --------------------------------------------------------------------


def test_targets_differ_by_environment_and_can_be_set() -> None:
    drive = PositionDrive(10.0, target=np.array([0.0, 0.2]))
    r = Rig(made("revolute", None, drive=drive), 2)
    x = r.positions(r.start[None].repeat(2, axis=0))

    def efforts() -> np.ndarray:
        r.joints.end_step(r.active, x)
        return r.joints.efforts.numpy()[:, 0]

    np.testing.assert_allclose(efforts(), [0, 2.0], atol=1e-12)
    r.joints.state.targets.assign(np.array([[0.3], [-0.1]]))
    r.begin(r.start)
    np.testing.assert_allclose(efforts(), [3.0, -1.0], atol=1e-12)


def test_multipliers_take_over_the_force() -> None:
    """The same force with no violation left to cause it."""
    r = Rig(made("revolute", None), 1)
    off = placed(r, np.array([1e-6, 0, 0]), quaternion(np.array([0, 1.0, 0]), 1e-6))
    x = r.positions(off[None])
    before = r.gradient(off[None])[0]
    r.joints.update_multipliers(r.active, x)
    assert r.joints.violations.numpy()[0] == pytest.approx(1e-6, rel=1e-6)
    after = r.gradient(r.start[None])[0]
    np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-5 * np.abs(before).max())
    # A violation below the tolerance changes nothing.
    r.joints.update_multipliers(r.active, r.positions(r.start[None]))
    assert r.joints.violations.numpy()[0] < 1e-15
    np.testing.assert_array_equal(r.gradient(r.start[None])[0], after)
    r.joints.restore(r.active)  # As where a step failed.
    np.testing.assert_allclose(r.gradient(r.start[None])[0], 0, atol=1e-6)


def test_a_limit_pushes_and_never_pulls() -> None:
    r = Rig(made("prismatic", None, limits_mm=(-2.0, 3.0)), 1)

    def force(way: float) -> float:
        return float(r.gradient(placed(r, way * AXIS, quaternion(AXIS, 0.0))[None])[0, 0] @ AXIS)

    # Rounding of the frames is all there is.
    assert abs(force(2.99e-3)) < 1e-20 and abs(force(-1.99e-3)) < 1e-20
    assert force(3.01e-3) > 0 > force(-2.01e-3)
    beyond = placed(r, 3.01e-3 * AXIS, quaternion(AXIS, 0.0))[None]
    r.joints.update_multipliers(r.active, r.positions(beyond))
    assert r.joints.violations.numpy()[0] == pytest.approx(1e-5)
    held = force(3e-3)
    assert held > 0
    # Off the limit, the multiplier's force is gone, and not converged until it is forgotten.
    assert abs(force(2.98e-3)) < 1e-20
    away = placed(r, 2.98e-3 * AXIS, quaternion(AXIS, 0.0))[None]
    r.joints.update_multipliers(r.active, r.positions(away))
    assert r.joints.violations.numpy()[0] > 9e-6
    assert force(3e-3) == pytest.approx(0, abs=1e-9 * held)


# Frames that move -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", list(KINDS))
def test_motion_of_a_kinematic_frame_reaches_the_right_hand_side(kind: str) -> None:
    """To first order, the change of the force that the motion causes."""
    r = Rig(made(kind, "k"), 1)
    goal = POSE_K.copy()
    step = 1e-7
    goal[:3] += step * np.array([1, -2, 0.5])
    goal[3:] += step * np.array([0.3, 0.2, -0.4, 0.1])
    goal[3:] /= np.linalg.norm(goal[3:])
    goals = wp.array(goal[None, None], dtype=wp.transformd)
    nodes = r.start[None]
    system = empty_system(r.model)
    r.joints.set_frames(r.poses, goals)
    r.joints.add_hessian(r.active, r.positions(nodes), system)
    rhs = system.rhs.numpy()[0]
    still = r.gradient(nodes)[0]
    r.joints.set_frames(goals)
    moved = r.gradient(nodes)[0]
    assert np.abs(moved - still).max() > 1e-3
    np.testing.assert_allclose(rhs, still - moved, atol=1e-5 * np.abs(moved).max())


def test_absent_bodies_have_no_joint() -> None:
    scene = Scene(
        affine_bodies=[
            AffineBody(
                box_mesh((0.1, 0.02, 0.03)),
                name="a",
                initial_pose=POSE_A,
                surface=Surface(environments=(1,)),
            )
        ],
        joints=[made("revolute", None)],
        env_count=2,
        time=TimeStepping(quasi_static=False, dt_s=DT),
    )
    model = scene.finalize()
    state = initial_state(model)
    dense = Dense(model, JointPotential(model), state.positions.numpy()[0])
    dense.potential.begin_step(state.positions, state.poses)
    forces = dense.gradient(np.repeat(dense.base[dense.free][None] + 1e-3, 2, axis=0))
    np.testing.assert_array_equal(forces[0], 0)
    assert np.abs(forces[1]).max() > 1


def test_each_environment_has_its_own_initial_configuration() -> None:
    """Bodies placed elsewhere in environment 1, and the joint with them."""
    shift = np.array([0.3, -0.2, 0.1])
    turn = quaternion(np.array([1.0, 2.0, 3.0]), 1.2)
    poses = np.stack([POSE_A, np.concatenate([rotate(turn, POSE_A[:3]) + shift, turn])])
    joint = RevoluteJoint(
        "a",
        None,
        np.stack([ANCHOR, rotate(turn, ANCHOR) + shift]),
        np.stack([AXIS, rotate(turn, AXIS)]),
    )
    scene = Scene(
        affine_bodies=[AffineBody(box_mesh((0.1, 0.02, 0.03)), name="a", initial_pose=poses)],
        joints=[joint],
        env_count=2,
        time=TimeStepping(quasi_static=False, dt_s=DT),
    )
    model = scene.finalize()
    state = initial_state(model)
    joints = JointPotential(model)
    active = wp.full(2, 1, dtype=wp.int32)
    joints.begin_step(state.positions, state.poses)
    joints.update_multipliers(active, state.positions)
    assert joints.violations.numpy().max() < 1e-15
    # The same swing in both has the same angle and the same forces in their own frames.
    x = state.positions.numpy().copy()
    swing = quaternion(AXIS, 0.4)
    x[0, 0] = rotate(swing, x[0, 0] - ANCHOR) + ANCHOR + 1e-6
    x[0, 1:4] = rotate(swing, x[0, 1:4])
    x[1, 0] = rotate(turn, x[0, 0]) + shift
    x[1, 1:4] = rotate(turn, x[0, 1:4])
    moved = wp.array(x, dtype=wp.vec3d)
    gradient = wp.zeros_like(moved)
    joints.add_gradient(active, moved, gradient)
    forces = gradient.numpy()[:, :4]
    assert np.abs(forces).max() > 0.1
    np.testing.assert_allclose(forces[1], rotate(turn, forces[0]), atol=1e-7 * np.abs(forces).max())
    joints.end_step(active, moved)
    np.testing.assert_allclose(joints.coordinates.numpy()[:, 0], 0.4, atol=1e-12)
