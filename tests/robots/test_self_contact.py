# SPDX-License-Identifier: Apache-2.0
"""Robots that touch themselves: gels on links of other fingers, links on links that drives move."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.outputs import Outputs
from taccel_lab.robots import Robot, drive, named, on_seat
from taccel_lab.scene import AffineBody, PositionDrive, Scene, Surface, box_mesh
from taccel_lab.solvers import Control
from tests.robots.gels import GEL, PAD, G, Run, driven_scene, moving, padded_hand
from tests.support.intersection import find_intersections

DRIVES = PositionDrive(stiffness=5.0, damping=0.05)
Pairs = set[frozenset[str]]


def touching(robot: Robot, *others: Robot, body: AffineBody | None = None) -> Pairs:
    """Pairs that may touch, without the hand's name."""
    robots = (robot, *others)
    scene = Scene(
        [gel for r in robots for gel in r.soft_bodies()],
        [link for r in robots for link in r.kinematic_bodies()],
        time=moving(0.02) if body else None,
        affine_bodies=[body] if body else [],
    )
    return {
        frozenset(one.name.removeprefix("three_finger_hand/") for one in (a, b))
        for i, a in enumerate(scene.bodies)
        for b in scene.bodies[:i]
        if scene.may_touch(a, b)
    }


def test_gels_touch_all_links_but_those_that_carry_them() -> None:
    hand = padded_hand()
    gels = {frozenset((f"pad {a}", f"pad {b}")) for a, b in ((1, 2), (1, 3), (2, 3))}
    assert touching(hand) == gels
    links = ["palm", *(f"{part}_{k}" for part in ("base", "proximal", "distal") for k in (1, 2, 3))]
    wanted = gels | {
        frozenset((f"pad {k}", link)) for k in (1, 2, 3) for link in links if link != f"distal_{k}"
    }
    assert touching(hand.touching_itself()) == wanted
    apart = [("pad 1", "palm"), ("distal_2", "pad 3"), ("pad 2", "pad 1")]
    assert touching(hand.touching_itself(apart)) == wanted - set(map(frozenset, apart))
    # What is made of it by parts says anew whether it touches itself.
    assert hand.touching_itself().part("base_1").apart is None
    other = replace(named("parallel_gripper"), name="other").mount("finger_left", GEL, name="left")
    box = AffineBody(box_mesh((6e-3, 6e-3, 6e-3)), name="box")
    for second, both in ((other, False), (replace(other, apart=()), True)):
        found = touching(hand.touching_itself(), second, body=box)
        assert (frozenset(("pad 1", "other/palm")) in found) is both
        assert (frozenset(("left", "palm")) in found) is both
        for body in ("pad 1", "left", "distal_2", "other/palm"):
            assert frozenset((body, "box")) in found


def test_a_gel_is_squeezed_between_fingers() -> None:
    """One pad alone, which meets the other finger's own shape; it passes through without."""
    robot = named("parallel_gripper").mount("finger_left", GEL, on_seat(PAD), "pad")
    pushes = []
    for made in (robot, robot.touching_itself(at=[0.02])):
        # The seat's distance from the middle is the coordinate; faces are 3 mm apart at 3 mm.
        scene = Scene(made.soft_bodies(), made.kinematic_bodies())
        run = Run(scene, made.targets([2e-3]), dhat_m=5e-5, relative_tolerance=1e-6)
        for slide in (1.6e-3, 1.4e-3, 1.2e-3):
            run.step(made.targets([slide]))
        wrenches = Outputs(run.solver).update(run.state).contact_wrenches().wrenches.numpy()[0]
        ids = {body.name.rpartition("/")[2]: i for i, body in enumerate(run.model.bodies)}
        pad, other, own = ids["pad"], ids["finger_right"], ids["finger_left"]
        np.testing.assert_allclose(wrenches[pad, other, :3], -wrenches[other, pad, :3])
        assert not wrenches[pad, own].any()
        pushes.append(np.linalg.norm(wrenches[pad, other, :3]))
    # 0.6 mm of 3 mm, bonded on one side: more than free compression of 64 mm^2 at 100 kPa.
    assert pushes[0] == 0.0 and 1 < pushes[1] / (64e-6 * 1e5 * 0.2) < 5


@pytest.mark.thorough
def test_driven_fingers_stop_at_one_another() -> None:
    robot = named("three_finger_hand").placed([0, 0, 0.2, 0, 0, 0, 1])
    goal = np.tile([0.0, 0.75, 0.6], 3)
    for itself in (False, True):
        driven = drive(robot.touching_itself() if itself else robot, DRIVES)
        run = Run(driven_scene(driven, moving(0.02, G)), driven.poses(1), relative_tolerance=1e-5)
        run.step(Control(joint_targets=driven.joint_targets(goal)), 40)
        knuckles = run.coordinates(driven)[0, 1::3]
        wrenches = Outputs(run.solver).update(run.state).contact_wrenches().wrenches.numpy()[0]
        if not itself:
            np.testing.assert_allclose(knuckles, 0.75, atol=0.01)
            assert not wrenches.any()
            continue
        assert (knuckles < 0.3).all()
        assert not any(find_intersections(run.model, run.state))
        tips = [i for i, body in enumerate(run.model.bodies) if "distal" in body.name]
        forces = wrenches[np.ix_(tips, tips)][..., :3]
        np.testing.assert_allclose(forces, -forces.transpose(1, 0, 2), atol=1e-9)
        assert (np.linalg.norm(forces.sum(axis=1), axis=1) > 1).all()
        # Knuckles push as hard as their drives can.
        np.testing.assert_allclose(run.efforts()[1::3], 2.0, rtol=1e-6)


def test_what_overlaps_and_bad_pairs_are_refused_by_name() -> None:
    folded, palms = np.tile([0.0, 1.4, 1.2], 3), [(f"pad {k}", "palm") for k in (1, 2, 3)]
    with pytest.raises(InputError) as error:
        padded_hand().touching_itself(at=folded)
    assert all(str(pair) in str(error.value) for pair in palms)
    padded_hand().touching_itself(palms, at=folded)
    meeting = np.tile([0.0, 0.2, 0.6], 3)
    bare = named("three_finger_hand").touching_itself()
    with pytest.raises(InputError, match=r"overlap .*\('distal_1', 'distal_2'\)"):
        drive(bare, DRIVES, meeting)
    tips = [("distal_1", "distal_2"), ("distal_2", "distal_3"), ("distal_1", "distal_3")]
    driven = drive(bare.touching_itself(tips), DRIVES, meeting)
    apart = {body.name: body.surface.apart_from for body in driven.affine_bodies}
    assert "three_finger_hand/distal_3" in apart["three_finger_hand/distal_1"]
    bad: list[tuple[Any, str]] = [
        ([("pad 1", "thumb")], "apart names 'thumb', which is no link or gel of robot 'three_f"),
        (["ab"], "apart has pairs of names of links and gels, got 'ab'"),
        ([("pad 1", "palm", "pad 2")], "apart has pairs of names"),
    ]
    for pairs, message in bad:
        with pytest.raises(InputError, match=message):
            padded_hand().touching_itself(pairs)
    lonely = replace(GEL, name="gel", surface=Surface(apart_from=frozenset({"nobody"})))
    with pytest.raises(InputError, match="'gel' is kept apart from 'nobody', which is no body"):
        Scene(lonely)
