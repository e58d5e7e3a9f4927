# SPDX-License-Identifier: Apache-2.0
"""Joints that make no sense are refused with what was found and what is allowed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.scene import (
    AffineBody,
    FixedJoint,
    Joint,
    KinematicBody,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    TimeStepping,
    VelocityDrive,
    box_mesh,
)

NAN, INF = float("nan"), float("inf")
BOX = box_mesh((0.1, 0.1, 0.1))


def scene(*joints: Joint, env_count: int = 1) -> Scene:
    return Scene(
        affine_bodies=[AffineBody(BOX, name="a"), AffineBody(BOX, name="b")],
        kinematic_bodies=[KinematicBody(None, name="k")],
        joints=joints,
        env_count=env_count,
        time=TimeStepping(quasi_static=False),
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axis": (0, 0, 0)}, "axis of joint 'j' must not be zero"),
        ({"axis": (0, NAN, 1)}, "axis of joint 'j' must be three finite numbers"),
        ({"anchor_m": (0, 1)}, "anchor_m of joint 'j'"),
        ({"anchor_m": (0, 1, INF)}, "anchor_m of joint 'j'"),
        ({"second": "a"}, "connects 'a' with itself"),
        ({"first": ""}, "needs the name of its first body"),
        ({"limits_deg": (10, 20)}, "low <= 0 <= high"),
        ({"limits_deg": (20, -20)}, "low <= 0 <= high"),
        ({"limits_deg": (NAN, 1)}, "low <= 0 <= high"),
        ({"second_pose": np.ones(7), "second": "k"}, "unit quaternion"),
        ({"second_pose": np.ones(6), "second": "k"}, "second_pose of joint 'j' must have shape"),
        ({"second_pose": np.array([0, 0, 0, 0, 0, 0, 1.0])}, "the world, which has no second_pose"),
        ({"drive": 3.0}, "must be a PositionDrive or a VelocityDrive"),
    ],
)
def test_bad_joints(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        RevoluteJoint(**{"first": "a", "name": "j"} | options)


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        (PositionDrive, {"stiffness": 0}, "stiffness of a drive must be positive"),
        (PositionDrive, {"stiffness": -1}, "stiffness"),
        (PositionDrive, {"stiffness": INF}, "stiffness"),
        (PositionDrive, {"stiffness": 1, "damping": -1}, "damping"),
        (PositionDrive, {"stiffness": 1, "target": NAN}, "target of a drive must be finite"),
        (PositionDrive, {"stiffness": 1, "max_effort": 0}, "max_effort"),
        (VelocityDrive, {"damping": 0}, "damping"),
        (VelocityDrive, {"damping": 1, "max_effort": NAN}, "max_effort"),
        (VelocityDrive, {"damping": 1, "target": np.zeros((2, 2))}, "target"),
    ],
)
def test_bad_drives(kind: type, options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        kind(**options)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([FixedJoint("c")], "first of joint 'joint' must be the name of one affine body, got 'c'"),
        ([FixedJoint("k")], "there are 'a', 'b'"),
        ([FixedJoint("a", "c")], "second of joint.*affine or kinematic body.*'a', 'b', 'k'"),
        ([Joint("a")], "must be a FixedJoint, RevoluteJoint or PrismaticJoint"),
        ([FixedJoint("a"), FixedJoint("b")], "2 joints are called 'joint'"),
        ([FixedJoint("a", anchor_m=np.zeros((3, 3)))], "anchor_m of.*3 rows, expected 2"),
        (
            [FixedJoint("a", "b", second_pose=np.array([0, 0, 0, 0, 0, 0, 1.0]))],
            "'b' is affine and has an initial pose",
        ),
        (
            [PrismaticJoint("a", drive=PositionDrive(1.0, target=np.zeros(3)))],
            r"drive target.*\(3,\), expected a number or \[2\]",
        ),
    ],
)
def test_joints_that_do_not_fit_the_scene(joints: list[Joint], words: str) -> None:
    with pytest.raises(InputError, match=words):
        scene(*joints, env_count=2)


def test_units_and_defaults() -> None:
    hinge = RevoluteJoint("a", axis=(0, 3, 4), limits_deg=(-90, 180))
    np.testing.assert_allclose(hinge.axis, [0, 0.6, 0.8])
    assert hinge.limits == pytest.approx((-math.pi / 2, math.pi))
    assert PrismaticJoint("a", limits_mm=(0, 5)).limits == pytest.approx((0, 5e-3))
    assert FixedJoint("a").limits == (-INF, INF)
    assert hinge.motor is None


def test_bodies_of_a_joint_do_not_touch_unless_asked() -> None:
    for touch in (False, True):
        made = scene(RevoluteJoint("a", "b", bodies_touch=touch))
        a, b = made.affine_bodies
        assert made.may_touch(a, b) is touch
