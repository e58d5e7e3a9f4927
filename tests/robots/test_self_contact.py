# SPDX-License-Identifier: Apache-2.0
"""Robots that touch themselves: gels on links of other fingers, links on links that drives move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs
from taccel_lab.robots import Robot, drive, named, on_seat
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    PositionDrive,
    Scene,
    SoftBody,
    Surface,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.support.intersection import find_intersections

PAD = block_mesh((4, 4, 2), (8e-3, 8e-3, 3e-3), jitter=0.1)
GEL = SoftBody(PAD, Material(1e5, 0.45), friction_coefficient=0.8, element=Element.LINEAR)
DRIVES = PositionDrive(stiffness=5.0, damping=0.05)
FOLDED = np.tile([0.0, 1.4, 1.2], 3)


def hand() -> Robot:
    robot = named("three_finger_hand")
    for k in (1, 2, 3):
        robot = robot.mount(f"pad_{k}", GEL, on_seat(PAD), f"pad {k}")
    return robot


def touching(scene: Scene) -> set[frozenset[str]]:
    bodies = scene.bodies
    return {
        frozenset((a.name, b.name))
        for i, a in enumerate(bodies)
        for b in bodies[:i]
        if scene.may_touch(a, b)
    }


def pairs_of(robot: Robot) -> set[frozenset[str]]:
    """Pairs that may touch, without the robot's name."""
    scene = Scene(robot.soft_bodies(), robot.kinematic_bodies())
    return {
        frozenset(name.removeprefix("three_finger_hand/") for name in pair)
        for pair in touching(scene)
    }


def test_gels_touch_all_links_but_those_that_carry_them() -> None:
    gels = {frozenset((f"pad {a}", f"pad {b}")) for a, b in ((1, 2), (1, 3), (2, 3))}
    assert pairs_of(hand()) == gels
    links = ["palm", *(f"{part}_{k}" for part in ("base", "proximal", "distal") for k in (1, 2, 3))]
    wanted = {
        frozenset((f"pad {k}", link)) for k in (1, 2, 3) for link in links if link != f"distal_{k}"
    }
    assert pairs_of(hand().touching_itself()) == gels | wanted
    apart = [("pad 1", "palm"), ("distal_2", "pad 3"), ("pad 2", "pad 1")]
    assert pairs_of(hand().touching_itself(apart)) == (gels | wanted) - set(map(frozenset, apart))
    # What is made of it by parts says anew whether it touches itself.
    assert hand().touching_itself().part("base_1").apart is None


def test_objects_and_other_robots() -> None:
    robot = hand().touching_itself()
    other = replace(named("parallel_gripper"), name="other").mount("finger_left", GEL, name="left")
    box = AffineBody(box_mesh((6e-3, 6e-3, 6e-3)), name="box")
    for second, both in ((other, False), (replace(other, apart=()), True)):
        scene = Scene(
            [*robot.soft_bodies(), *second.soft_bodies()],
            [*robot.kinematic_bodies(), *second.kinematic_bodies()],
            time=TimeStepping(quasi_static=False),
            affine_bodies=box,
        )
        found = touching(scene)
        assert (frozenset(("pad 1", "other/palm")) in found) is both
        assert (frozenset(("left", "three_finger_hand/palm")) in found) is both
        for body in ("pad 1", "left", "three_finger_hand/distal_2", "other/palm"):
            assert frozenset((body, "box")) in found


def test_a_gel_is_squeezed_between_fingers() -> None:
    """One pad alone, which meets the other finger's own shape; it passes through without."""
    robot = named("parallel_gripper").mount("finger_left", GEL, on_seat(PAD), "pad")
    config = SolverConfig(dhat_m=5e-5, relative_tolerance=1e-6)
    pushes = {}
    for itself in (False, True):
        made = robot.touching_itself(at=[0.02]) if itself else robot
        model = Scene(made.soft_bodies(), made.kinematic_bodies()).finalize("cpu")
        solver = SolverIPC(model, config)
        # The seat's distance from the middle is the coordinate; faces are 3 mm apart at 3 mm.
        state = initial_state(model, made.targets([2e-3]))
        for slide in (1.6e-3, 1.4e-3, 1.2e-3):
            report = solver.step(state, made.targets([slide]))
            assert report.converged.all(), report.summary()
        wrenches = Outputs(solver).update(state).contact_wrenches().wrenches.numpy()[0]
        ids = {body.name.rpartition("/")[2]: i for i, body in enumerate(model.bodies)}
        pad, other, own = ids["pad"], ids["finger_right"], ids["finger_left"]
        np.testing.assert_allclose(wrenches[pad, other, :3], -wrenches[other, pad, :3])
        assert not wrenches[pad, own].any()
        pushes[itself] = np.linalg.norm(wrenches[pad, other, :3])
    assert pushes[False] == 0.0
    # 0.6 mm of 3 mm, bonded on one side: more than free compression of 64 mm^2 at 100 kPa.
    assert 64e-6 * 1e5 * 0.2 < pushes[True] < 5 * 64e-6 * 1e5 * 0.2


@pytest.mark.thorough
def test_driven_fingers_stop_at_one_another() -> None:
    robot = named("three_finger_hand").placed([0, 0, 0.2, 0, 0, 0, 1])
    for itself in (False, True):
        driven = drive(robot.touching_itself() if itself else robot, DRIVES)
        scene = Scene(
            driven.soft_bodies,
            driven.kinematic_bodies,
            time=TimeStepping(quasi_static=False, dt_s=0.02, gravity_m_s2=(0, 0, -9.81)),
            affine_bodies=driven.affine_bodies,
            joints=driven.joints,
        )
        solver = SolverIPC(scene.finalize("cpu"), SolverConfig(relative_tolerance=1e-5))
        state = initial_state(solver.model, driven.poses(1))
        told = np.tile([0.0, 0.75, 0.6], 3)
        for _ in range(40):
            report = solver.step(state, Control(joint_targets=driven.joint_targets(told)))
            assert report.converged.all(), report.summary()
        knuckles = driven.coordinates(solver.joints.coordinates.numpy())[0, 1::3]
        wrenches = Outputs(solver).update(state).contact_wrenches().wrenches.numpy()[0]
        if not itself:
            np.testing.assert_allclose(knuckles, 0.75, atol=0.01)
            assert not wrenches.any()
            continue
        assert (knuckles < 0.3).all()
        assert not any(find_intersections(solver.model, state))
        tips = [i for i, body in enumerate(solver.model.bodies) if "distal" in body.name]
        forces = wrenches[np.ix_(tips, tips)][..., :3]
        np.testing.assert_allclose(forces, -forces.transpose(1, 0, 2), atol=1e-9)
        assert (np.linalg.norm(forces.sum(axis=1), axis=1) > 1).all()
        # Knuckles push as hard as their drives can.
        np.testing.assert_allclose(solver.joints.efforts.numpy()[0, 1::3], 2.0, rtol=1e-6)


def test_what_overlaps_is_refused_by_name() -> None:
    with pytest.raises(InputError) as error:
        hand().touching_itself(at=FOLDED)
    for k in (1, 2, 3):
        assert f"('pad {k}', 'palm')" in str(error.value)
    palms = [(f"pad {k}", "palm") for k in (1, 2, 3)]
    hand().touching_itself(palms, at=FOLDED)
    meeting = np.tile([0.0, 0.2, 0.6], 3)
    bare = named("three_finger_hand").touching_itself()
    with pytest.raises(InputError, match=r"overlap .*\('distal_1', 'distal_2'\)"):
        drive(bare, DRIVES, meeting)
    tips = [("distal_1", "distal_2"), ("distal_2", "distal_3"), ("distal_1", "distal_3")]
    driven = drive(bare.touching_itself(tips), DRIVES, meeting)
    named_so = {body.name: body.surface.apart_from for body in driven.affine_bodies}
    assert "three_finger_hand/distal_3" in named_so["three_finger_hand/distal_1"]


def test_bad_pairs_are_refused() -> None:
    for apart, message in (
        ([("pad 1", "thumb")], "apart names 'thumb', which is no link or gel of robot 'three_f"),
        (["ab"], "apart has pairs of names of links and gels, got 'ab'"),
        ([("pad 1", "palm", "pad 2")], "apart has pairs of names"),
    ):
        with pytest.raises(InputError, match=message):
            hand().touching_itself(apart)  # type: ignore[arg-type]
    lonely = replace(GEL, name="gel", surface=Surface(apart_from=frozenset({"nobody"})))
    with pytest.raises(InputError, match="'gel' is kept apart from 'nobody', which is no body"):
        Scene(lonely)
