# SPDX-License-Identifier: Apache-2.0
"""Outputs of solved steps: action and reaction, balance with motion, gaps, energies, torch."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.stress.gaps import SurfacePairs
from taccel_lab.errors import InputError, InputWarning
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import GelFrames, Outputs, to_torch
from taccel_lab.scene import (
    AffineBody,
    Ball,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.signals import SignalTactile, resultant_wrench
from taccel_lab.solvers.tangent import Tangent
from taccel_lab.state import State
from tests.support.blocks import pose
from tests.support.intersection import find_intersections
from tests.support.scene_steps import Stepped, linear

DT, G = 5e-3, np.array([0.3, 0.0, -9.81])
GEL, CUBE, BALL = 0, 1, 3
DHAT = 2e-5
GRID = PixelGrid(4, 4, 0.5, 0.5)


class Pressed(Stepped):
    """A cube between a gel and a ball, and one on a floor, after some steps in two environments."""

    before: State
    outputs: Outputs


@pytest.fixture(scope="module")
def pressed() -> Pressed:
    mesh = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.2)
    side, floor = 1.5e-3, -4e-3
    cubes = [
        AffineBody(
            box_mesh((side,) * 3),
            density_kg_m3=8000,
            friction_coefficient=0.5,
            initial_pose=pose(x, 0, z + 0.5 * side + 1e-5, (0, 0, 1), 20.0),
            name=name,
        )
        for name, x, z in (("cube", 1e-4, 0), ("brick", 8e-3, floor))
    ]
    scene = Scene(
        linear(mesh, Material(1e5, 0.45), friction_coefficient=0.5),
        KinematicBody(Ball(1e-3), 0.5, name="ball"),
        2,
        TimeStepping(False, DT, tuple(G)),
        affine_bodies=cubes,
        planes=Plane((0, 0, floor), friction_coefficient=0.5, name="floor"),
    )

    def ball(k: int) -> np.ndarray:
        z = side + 1.1e-3 - 4e-5 * k
        return np.stack([pose(2e-5 * k, e * 1e-4, z, (0, 1, 0), 0.5 * k)[None] for e in (0, 1)])

    run = Pressed(scene, ball(0), dhat_m=DHAT, relative_tolerance=1e-9, absolute_tolerance_n=1e-9)
    for k in range(1, 6):
        run.before = run.state.copy()
        assert (run.step(ball(k)).substeps == 1).all()
    run.outputs = Outputs(run.solver).update(run.state)
    return run


def test_action_is_reaction_for_each_pair(pressed: Pressed) -> None:
    normal = pressed.outputs.contact_wrenches().wrenches.numpy()
    friction = pressed.outputs.friction_wrenches().wrenches.numpy()
    for wrenches in (normal, friction):
        force = wrenches[..., :3]
        scale = np.abs(force).max()
        assert scale > 1e-3
        np.testing.assert_allclose(force, -np.swapaxes(force, 1, 2), atol=1e-12 * scale)
        touching = {tuple(p) for p in np.argwhere(np.abs(force[0]).max(-1) > 1e-9 * scale)}
        assert touching == {(0, 1), (1, 0), (1, 3), (3, 1), (2, 4), (4, 2)}
    torque = normal[..., 3:]
    np.testing.assert_allclose(
        torque, -np.swapaxes(torque, 1, 2), atol=1e-12 * np.abs(torque).max()
    )
    # Friction acts on two surfaces that are a gap apart.
    torque, force = friction[..., 3:], np.linalg.norm(friction[..., :3], axis=-1)
    couple = np.linalg.norm(torque + np.swapaxes(torque, 1, 2), axis=-1)
    assert (couple <= 2 * DHAT * force + 1e-15).all()
    assert couple.max() > 0


def test_pairs_add_up_to_the_nodal_forces(pressed: Pressed) -> None:
    o, x = pressed.outputs, pressed.state.positions.numpy()
    for nodal, pairs in (
        (o.normal_forces.numpy(), o.contact_wrenches()),
        (o.friction_forces.numpy(), o.friction_wrenches()),
    ):
        totals = pairs.totals().numpy()
        for body in (GEL, CUBE, 2):
            nodes = pressed.model.bodies[body].node_slice
            expected = resultant_wrench(x[:, nodes], nodal[:, nodes])
            # Of the forces that are added up: friction all round the cube cancels.
            scale = np.linalg.norm(nodal[:, nodes], axis=-1).sum()
            np.testing.assert_allclose(totals[:, body], expected, atol=1e-12 * scale)


def test_a_soft_body_has_the_sum_of_its_pairs(pressed: Pressed) -> None:
    o, solver = pressed.outputs, pressed.solver
    wrenches = o.soft_wrenches().numpy()
    pairs = o.contact_wrenches().totals().numpy() + o.friction_wrenches().totals().numpy()
    scale = np.linalg.norm(solver.contact_gradient.numpy()[:, :75], axis=-1).sum()
    assert wrenches.shape == (2, 1, 6)
    np.testing.assert_allclose(wrenches[:, 0], pairs[:, GEL], atol=1e-12 * scale)
    assert np.abs(wrenches[0] - wrenches[1]).max() > 1e-6 * scale, "environments were to differ"
    second = o.soft_wrenches(np.array([False, True])).numpy()
    np.testing.assert_array_equal(second, wrenches[1:])
    assert o.soft_wrenches(np.array([False, False])).shape == (0, 1)
    with pytest.raises(InputError, match=r"a mask is bool of shape \[2\]"):
        o.soft_wrenches(np.array([1]))


def test_torques_move_with_the_point_of_reference(pressed: Pressed) -> None:
    center = np.array([0.3, -0.2, 0.7])
    for read in (pressed.outputs.contact_wrenches, pressed.outputs.friction_wrenches):
        here, there = read().wrenches.numpy(), read(tuple(center)).wrenches.numpy()
        np.testing.assert_array_equal(here[..., :3], there[..., :3])
        moved = here[..., 3:] - np.cross(center, here[..., :3])
        np.testing.assert_allclose(there[..., 3:], moved, atol=1e-13)


def test_the_ball_is_pushed_through_its_centre_and_rubbed_on_its_surface(pressed: Pressed) -> None:
    for env in range(2):
        centre = pressed.state.poses.numpy().reshape(2, 7)[env, :3]
        at_centre = tuple(centre)
        normal = pressed.outputs.contact_wrenches(at_centre).wrenches.numpy()[env, BALL, CUBE]
        assert np.abs(normal[3:]).max() < 1e-12 * 1e-3 * np.abs(normal[:3]).max() + 1e-18
        friction = pressed.outputs.friction_wrenches(at_centre).wrenches.numpy()[env, BALL, CUBE]
        # The cube's top is below the ball: the lever is close to (0, 0, -radius).
        lever = np.cross([0, 0, -1e-3], friction[:3])
        assert np.linalg.norm(friction[:2]) > 1e-4
        np.testing.assert_allclose(friction[3:5], lever[:2], atol=0.05 * np.abs(lever).max())


@pytest.mark.parametrize("body", [CUBE, 2])
def test_forces_are_the_change_of_momentum(pressed: Pressed, body: int) -> None:
    """m (v - v_before) / dt = contact + friction + weight, and the same for torques."""
    p = pressed
    mass = p.model.affine.properties[body - 1].mass_kg
    now = p.outputs.momentum()
    before = Outputs(p.solver).update(p.before).momentum()
    impulse = (now.linear.numpy() - before.linear.numpy())[:, body] / DT
    total = p.outputs.contact_wrenches().totals().numpy()[:, body]
    total = total + p.outputs.friction_wrenches().totals().numpy()[:, body]
    np.testing.assert_allclose(impulse, total[:, :3] + mass * G, atol=3e-9)
    # The weight of the brick is carried by the floor, not by rounding.
    assert np.abs(total[:, 2]).min() > 0.5 * mass * 9.81


def test_gaps_are_those_of_the_referee(pressed: Pressed) -> None:
    gaps = pressed.outputs.contact_wrenches().gaps.numpy()
    np.testing.assert_array_equal(gaps, np.swapaxes(gaps, 1, 2))
    referee = SurfacePairs(pressed.model)
    for env in range(2):
        near = referee.nearer_than(
            pressed.state.positions.numpy()[env], np.ones(5, dtype=bool), DHAT
        )
        for pair in ((GEL, CUBE), (CUBE, BALL), (2, 4)):
            mine = (np.sort(near.bodies, axis=1) == pair).all(axis=1)
            assert gaps[env][pair] == pytest.approx(near.gaps_m[mine].min(), rel=1e-9)
        assert np.isinf(gaps[env, GEL, BALL])
        assert (gaps[env] > 0).all()


def test_tractions_and_stresses_belong_to_the_forces(pressed: Pressed) -> None:
    o, model = pressed.outputs, pressed.model
    load = o.surface_load
    total = load.tractions.numpy() * load.areas.numpy()[..., None]
    expected = o.normal_forces.numpy() + o.friction_forces.numpy()
    soft = slice(0, model.soft_count)
    np.testing.assert_allclose(total[:, soft], expected[:, soft], atol=1e-12)
    assert load.pressures.numpy()[:, soft].max() > 1e3
    peaks, nodes = o.bond_peak()
    held = set(model.scene.soft_bodies[0].bonded().tolist())
    assert set(nodes.numpy().tolist()) <= held
    assert (peaks.numpy() > 100).all()
    assert o.nodal_stresses.numpy()[:, model.soft_count :].max() == 0


def test_energies_by_name(pressed: Pressed) -> None:
    energies = pressed.outputs.energies
    assert set(energies) == {"elastic", "affine", "contact", "weight", "kinetic"}
    assert all(value.shape == (2,) for value in energies.values())
    assert (energies["elastic"] > 1e-7).all() and (energies["contact"] > 0).all()
    masses = [solid.mass_kg for solid in pressed.model.affine.properties]
    height = [pressed.state.positions.numpy()[:, node] @ G for node in (75, 79)]
    assert pressed.model.affine.control_starts.numpy().tolist() == [75, 79]
    gel = pressed.model.masses.numpy()[0, :75] @ (pressed.state.positions.numpy()[:, :75] @ G).T
    expected = -(masses[0] * height[0] + masses[1] * height[1] + gel)
    np.testing.assert_allclose(energies["weight"], expected, rtol=1e-12)


def test_arrays_are_shared_with_torch_and_numpy(pressed: Pressed) -> None:
    forces = pressed.outputs.normal_forces
    tensor = to_torch(forces)
    assert tuple(tensor.shape) == (2, pressed.model.node_count, 3)
    assert tensor.data_ptr() == forces.ptr
    wrenches = pressed.outputs.contact_wrenches().wrenches
    assert tuple(to_torch(wrenches).shape) == (2, 5, 5, 6)
    np.testing.assert_array_equal(np.from_dlpack(wrenches), wrenches.numpy())


def test_only_an_update_reads_anew(pressed: Pressed) -> None:
    outputs = Outputs(pressed.solver)
    with pytest.raises(RuntimeError, match="update"):
        _ = outputs.normal_forces
    outputs.update(pressed.state)
    first = outputs.von_mises
    assert outputs.von_mises is first
    outputs.update(pressed.before)
    assert np.abs(outputs.von_mises.numpy() - first.numpy()).max() > 10.0


def test_a_scene_without_friction_reads_zero() -> None:
    mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
    run = Stepped(Scene(linear(mesh), KinematicBody(Ball(1e-3))), pose(0, 0, 1.1e-3))
    run.step(pose(0, 0, 0.9e-3))
    outputs = Outputs(run.solver).update(run.state)
    assert not outputs.friction_wrenches().wrenches.numpy().any()
    assert not outputs.friction_forces.numpy().any()
    assert outputs.contact_wrenches().wrenches.numpy()[0, 0, 1, 2] < -1e-4
    assert set(outputs.energies) == {"elastic", "contact"}
    assert isinstance(outputs.normal_forces, wp.array)


def test_a_state_of_another_model_is_read_by_nobody() -> None:
    """Of a gel that has the same nodes and another stiffness no array tells the difference."""
    mesh, ball = block_mesh((2, 2, 1), (4e-3, 4e-3, 2e-3)), KinematicBody(Ball(1e-3))
    start = pose(0, 0, 1.1e-3)[None, None]
    run, other = (
        Stepped(Scene(linear(mesh, Material(young, 0.45)), ball), start, dhat_m=DHAT)
        for young in (1e5, 5e5)
    )
    solver, own, theirs = run.solver, run.state, other.state
    frames, signals = GelFrames(solver.model), SignalTactile.from_solver(solver, GRID)
    Outputs(solver).update(own)
    for state in (theirs, theirs.copy()):
        for read in (
            Outputs(solver).update,
            solver.require_latest,
            lambda state: solver.step(state, start),
            lambda state: Tangent(solver, state),
            lambda state: find_intersections(solver.model, state),
            frames.read,
            lambda state: frames.of(0, state),
            signals.update,
            own.restore,
        ):
            with pytest.raises(InputError, match="the state is one of another model"):
                read(state)


@pytest.mark.thorough
def test_a_gel_pressed_past_its_mesh_is_told() -> None:
    """A ball of a quarter of the gel's height: unsaid at 0.4 mm, said at 1.4 mm; what is read,
    and the step after it, stay as they are."""
    mesh = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3))
    gel = SoftBody(mesh, Material(1e5, 0.48), friction_coefficient=0.3)
    scene = Scene(gel, KinematicBody(Ball(5e-4), 0.3, name="ball"))
    run, unread = (Stepped(scene, pose(0, 0, 5.5e-4)) for _ in range(2))
    for depth in 1e-4 * np.arange(1, 15):
        for one in (run, unread):
            one.step(pose(0, 0, 5.5e-4 - depth))
        if depth == 1e-4 * 4:
            shares = Outputs(run.solver).update(run.state).guard_shares()
            assert np.array_equal(shares, [[0.0]])
    outputs = Outputs(run.solver).update(run.state)
    force = outputs.contact_wrenches().wrenches.numpy()
    with pytest.warns(InputWarning, match=r"carries 1\.9 % of the force on 'ball': the gel is"):
        shares = outputs.guard_shares()
    assert shares.shape == (1, 1) and 0.018 < shares[0, 0] < 0.02
    assert np.array_equal(outputs.contact_wrenches().wrenches.numpy(), force)
    for one in (run, unread):
        one.step(pose(0, 0, -9.5e-4))
    assert np.array_equal(run.state.positions.numpy(), unread.state.positions.numpy())
