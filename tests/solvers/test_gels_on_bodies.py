# SPDX-License-Identifier: Apache-2.0
"""Gels on bodies that move by dynamics: what holds them is the gel on a frame, moved by forces."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.outputs import GelFrames, Outputs
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    Plane,
    RevoluteJoint,
    Scene,
    SoftBody,
    TimeStepping,
    VelocityDrive,
    box_mesh,
)
from taccel_lab.solvers import Control
from tests.solvers.driven_grasp import (
    FORCE_N,
    HALF,
    PAD,
    SIDES,
    START_M,
    base_poses,
    driven_grasp,
    driven_squeeze,
    face_pose,
    prescribed_squeeze,
    time_of,
    toward,
)
from tests.solvers.steps import begun, stepped
from tests.support.blocks import cube, pose, soft_block
from tests.support.variants import variants

DHAT = 5e-5
SETTLING = 25
"""Steps in which the grip comes to rest."""


def lift(step: int) -> float:
    return 2e-4 * max(step - SETTLING, 0)


def pad(mount: str, at: np.ndarray, material: Material | None = None) -> SoftBody:
    return SoftBody(PAD, material or Material(1e5, 0.45), name="pad", mount=mount, mount_pose=at)


class Grasp:
    def __init__(self, scene: Scene, **options: object) -> None:
        self.poses = np.repeat(base_poses(scene.env_count), len(scene.kinematic_bodies), axis=1)
        self.solver, self.state = begun(scene, self.poses, dhat_m=DHAT, **options)
        self.model = self.solver.model

    def step(self, z_m: float = 0.0, targets: np.ndarray | None = None):
        poses = self.poses.copy()
        poses[:, 0, 2] = z_m
        return stepped(self.solver, self.state, Control(target_poses=poses, joint_targets=targets))

    def wrenches(self) -> np.ndarray:
        return Outputs(self.solver).update(self.state).soft_wrenches().numpy()

    def gel(self, side: str) -> np.ndarray:
        body = self.model.bodies[self.model.body_id(side)]
        return self.state.positions.numpy()[:, body.node_slice]


@pytest.mark.thorough
def test_drives_press_with_their_largest_force_and_lift() -> None:
    """Fingers and joints take nothing of the grip; the box hangs in the gels with its weight."""
    grasp = Grasp(driven_grasp())
    box = grasp.model.affine.first_control + 4 * 2
    for step in range(SETTLING):
        grasp.step(lift(step))
    np.testing.assert_allclose(-grasp.wrenches()[..., 2], FORCE_N, rtol=1e-3)
    stood = grasp.state.positions.numpy()[:, box, 2].copy()
    for step in range(SETTLING, SETTLING + 40):
        report = grasp.step(lift(min(step, SETTLING + 20)))
    assert report.newton_iterations.max() <= 10, "at rest a step is a few iterations"
    wrenches = grasp.wrenches()
    np.testing.assert_allclose(-wrenches[..., 2], FORCE_N, rtol=1e-3)
    rose = grasp.state.positions.numpy()[:, box, 2] - stood
    # It sinks in the gels by its weight over their stiffness against shear.
    np.testing.assert_allclose(rose, lift(SETTLING + 20), atol=4e-4)
    weight = 9.81 * grasp.model.affine.properties[2].mass_kg
    # The gels' x axis is the world's z, or its opposite.
    held = sum(-toward(side) * wrenches[:, i, 0] for i, side in enumerate(SIDES))
    np.testing.assert_allclose(np.abs(held), weight, rtol=1e-2)


@pytest.mark.thorough
def test_a_finger_converges_to_a_part_of_what_presses_on_its_gel() -> None:
    """It touches nothing itself, and yet ``absolute_tolerance_n`` does not decide. First contact,
    where it may, leaves states that differ by less than the tolerance."""

    def iterations(absolute_tolerance_n: float) -> list[int]:
        scene = driven_grasp(1, (Element.LINEAR, Element.LINEAR))
        grasp = Grasp(scene, absolute_tolerance_n=absolute_tolerance_n)
        return [int(grasp.step().newton_iterations[0]) for _ in range(SETTLING)][8:]

    tight, usual = np.array(iterations(1e-9)), np.array(iterations(1e-5))
    assert np.abs(tight - usual).max() <= 1 and np.count_nonzero(tight != usual) <= 1


@pytest.mark.thorough
@pytest.mark.parametrize("element", variants([Element.LINEAR], Element))
def test_it_is_the_gel_on_a_frame_that_goes_where_the_finger_went(element: Element) -> None:
    """The error is the strain of the finger, and falls with it: 1.4e-4 of the force with 1 GPa."""
    off = []
    for young_pa in (1e9, 1e11):
        scene = driven_squeeze((element, element), young_pa)
        driven = Grasp(scene, absolute_tolerance_n=1e-9, relative_tolerance=1e-7)
        for _ in range(80):
            driven.step()
        forces = -driven.wrenches()[..., 2]
        np.testing.assert_allclose(forces, FORCE_N, rtol=1e-6)
        assert driven.solver.joints is not None
        slides = driven.solver.joints.coordinates.numpy()[0]
        assert slides.min() > 5e-4, "the gels of 3 mm are squeezed"
        # Gels on frames that come to where fingers have slid, at rest.
        framed = Grasp(prescribed_squeeze((element, element)), absolute_tolerance_n=1e-9)
        for step in range(81):
            faces = START_M - min(step / 10, 1.0) * slides
            framed.poses[0, :2] = [face_pose(*face) for face in zip(SIDES, faces, strict=True)]
            if step == 0:
                framed.solver.reset(framed.state, np.ones(1, dtype=bool), framed.poses)
            else:
                stepped(framed.solver, framed.state, framed.poses)
        off.append(np.abs(forces / -framed.wrenches()[..., 2] - 1).max())
        apart = [np.abs(driven.gel(side) - framed.gel(side)).max() for side in SIDES]
        assert max(apart) < (1e-7 if young_pa == 1e9 else 5e-9)
    assert 2e-5 < off[0] < 2e-4 and off[1] < 0.02 * off[0]


def test_newton_takes_as_many_iterations_as_without_gels() -> None:
    """A body that turns takes its gel along from the start of the search."""

    def iterations(soft: list[SoftBody]) -> int:
        body = cube(1e-2, pose(0, 0.1, 0), "arm")
        hinge = RevoluteJoint("arm", axis=(1, 0, 0), drive=VelocityDrive(1.0, 5.0))
        time = TimeStepping(quasi_static=False, dt_s=0.01)
        solver, state = begun(Scene(soft, affine_bodies=body, joints=hinge, time=time))
        return sum([int(stepped(solver, state).newton_iterations[0]) for _ in range(12)][4:])

    assert iterations([pad("arm", pose(0, 0, 8e-3))]) <= iterations([]) + 8


@pytest.mark.thorough
def test_environments_are_as_if_alone_and_a_reset_starts_anew() -> None:
    together = Grasp(driven_grasp(3))
    alone = [Grasp(driven_grasp(1)) for _ in range(3)]
    wanted = np.array([[2e-3, 2e-3], [1e-3, 0.0], [2e-3, 2e-3]])
    for step in range(3):
        if step == 1:
            together.solver.reset(together.state, np.array([False, False, True]))
        together.step(targets=wanted)
        for env, one in enumerate(alone):
            if env < 2 or step:
                one.step(targets=wanted[env : env + 1])
    x = together.state.positions.numpy()
    for env, one in enumerate(alone):
        np.testing.assert_array_equal(x[env], one.state.positions.numpy()[0])
    assert not np.array_equal(x[2], x[0])


def test_gel_frames_follow_and_bonded_nodes_with_them() -> None:
    """A box that flies and spins, from other places in each environment."""
    body = AffineBody(
        box_mesh((1e-2, 2e-2, 3e-2)),
        name="box",
        initial_pose=np.array([[0, 0, 0, 0, 0, 0, 1], [0.3, -0.1, 0.2, HALF, 0, 0, HALF]]),
        initial_spin_rad_s=(4.0, -7.0, 5.0),
        initial_velocity_m_s=(0.1, 0.2, 0.0),
    )
    gel = pad("box", np.array([5e-3, 1e-3, 0, 0, HALF, 0, HALF]))
    loose = soft_block((1, 1, 1), (1e-3,) * 3, name="loose", initial_pose=pose(1.0, 0, 0))
    time = TimeStepping(quasi_static=False, dt_s=0.01)
    solver, state = begun(Scene([gel, loose], env_count=2, affine_bodies=body, time=time))
    frames, bonded = GelFrames(solver.model), PAD.bonded_nodes()
    for step in range(4):
        if step:
            stepped(solver, state)
        found = frames.read(state).numpy()
        np.testing.assert_array_equal(found[:, 1], [[0, 0, 0, 0, 0, 0, 1]] * 2)
        for env in range(2):
            turn = np.array(wp.quat_to_matrix(wp.quatd(*found[env, 0, 3:]))).reshape(3, 3)
            wanted = PAD.nodes_m[bonded] @ turn.T + found[env, 0, :3]
            np.testing.assert_allclose(state.positions.numpy()[env, bonded], wanted, atol=1e-8)
    assert frames.of(1, state) is None
    of_gel = frames.of(0, state)
    assert of_gel is not None
    np.testing.assert_array_equal(of_gel.numpy(), found[:, 0])


@pytest.mark.thorough
def test_parameters_by_environment_reach_the_body_that_carries_the_gel() -> None:
    """A heavier, softer gel in one environment is what a scene with such a gel has, bit by bit."""

    def hanging(material: Material, envs: int) -> Scene:
        gel = pad("arm", np.array([7e-3, 0, 0, 0, HALF, 0, HALF]), material)
        hinge = RevoluteJoint("arm", anchor_m=(-0.02, 0, 0), axis=(0, 1, 0), name="hinge")
        arm = cube(8e-3, name="arm")
        return Scene(gel, env_count=envs, affine_bodies=arm, joints=hinge, time=time_of(True))

    usual, other = Material(1e5, 0.45), Material(6e4, 0.45, density_kg_m3=3000.0)
    model = hanging(usual, 2).finalize()
    together = begun(model)
    model.set_body("pad", young_modulus_pa=6e4, density_kg_m3=3000.0, mask=np.array([False, True]))
    alone = [begun(hanging(material, 1)) for material in (usual, other)]
    for _ in range(6):
        for solver, state in (together, *alone):
            stepped(solver, state)
    x = together[1].positions.numpy()
    for env, (_, state) in enumerate(alone):
        np.testing.assert_array_equal(x[env], state.positions.numpy()[0])
    assert np.abs(x[1] - x[0]).max() > 1e-6


@pytest.mark.thorough
def test_a_glued_face_collides_and_rubs_as_its_body_does() -> None:
    """The floor bears the weight of block and gel, and Coulomb's friction stops both alike."""
    friction, dt = 0.4, 1e-3
    block = AffineBody(box_mesh((8e-3, 8e-3, 4e-3)), name="block", initial_velocity_m_s=(0.2, 0, 0))
    # Its glued face is the lowest one, 3 mm below its frame.
    gel = pad("block", pose(0, 0, -3e-3), Material(3e5, 0.4))
    floor = Plane((0, 0, -6e-3 - 2e-5), friction_coefficient=friction, name="floor")
    time = TimeStepping(quasi_static=False, dt_s=dt, gravity_m_s2=(0, 0, -9.81))
    solver, state = begun(Scene(gel, affine_bodies=block, planes=floor, time=time))
    model, outputs = solver.model, Outputs(solver)
    mass = model.masses.numpy()[0, model.bodies[0].node_slice].sum()
    weight = 9.81 * (mass + model.affine.properties[0].mass_kg)

    def momentum() -> np.ndarray:
        return outputs.update(state).momentum().linear.numpy()[0].sum(axis=0).copy()

    pressed = []
    for step in range(40):
        stepped(solver, state)
        if step == 29:
            before = momentum()
        if step > 29:
            pressed.append(outputs.update(state).soft_wrenches().numpy()[0, 0])
    change, force = momentum() - before, np.mean(pressed, axis=0)
    assert force[2] == pytest.approx(weight, rel=2e-2)
    assert change[0] == pytest.approx(10 * dt * force[0], rel=1e-3)
    assert change[0] == pytest.approx(-friction * weight * 10 * dt, rel=2e-2)
    slopes = np.linalg.norm(solver.contact_gradient.numpy()[0, : model.soft_count], axis=1)
    touching = np.flatnonzero(slopes > 1e-9)
    assert len(touching) >= 4
    assert (model.parents.numpy()[touching] >= 0).all(), "glued nodes alone touch"
