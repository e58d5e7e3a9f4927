# SPDX-License-Identifier: Apache-2.0
"""Poses that a robot can reach are reached, others are said to be out of reach."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.robots import IKOptions, Robot, named
from tests.support.robot_files import REAL, random_coordinates
from tests.support.sensor_refusals import refuses

HAND = named("three_finger_hand")
REST = HAND.link_poses("pad_1", HAND.rest_q)
SHARES = st.lists(st.floats(0.02, 0.98), min_size=9, max_size=9).map(np.array)


def arrives(robot: Robot, link: str, count: int, options: IKOptions) -> np.ndarray:
    """Whether random reachable poses are reached from random starts, checked by the forward way."""
    poses = robot.link_poses(link, random_coordinates(robot, count, 1))
    found = robot.inverse_kinematics(link, poses, random_coordinates(robot, count, 2), options)
    low, high = robot.limits.T
    assert ((found.q >= low) & (found.q <= high)).all()
    at = robot.link_poses(link, found.q)
    miss = np.linalg.norm(at[:, :3] - poses[:, :3], axis=1)
    np.testing.assert_allclose(miss, found.position_error_m, atol=1e-12)
    assert (miss[found.arrived] <= options.position_tolerance_m).all()
    if not options.position_only:
        chords = [np.linalg.norm(at[:, 3:] + s * poses[:, 3:], axis=1) for s in (-1, 1)]
        turn = 4 * np.arcsin(np.min(chords, axis=0) / 2)
        assert (turn[found.arrived] <= 1.01 * options.rotation_tolerance_rad + 1e-14).all()
    return found.arrived


@pytest.mark.parametrize("position_only", [False, True])
@pytest.mark.parametrize("name", ["three_finger_hand", *REAL])
def test_robots_reach_what_they_can(name: str, position_only: bool) -> None:
    robot, ours = named(name), name == "three_finger_hand"
    links = {"three_finger_hand": "pad_2", "panda": "panda_hand_tcp", "ur5_gripper": "tool0"}
    link = links.get(name, robot.link_names[-1])
    options = IKOptions(position_only=position_only)
    arrived = arrives(robot, link, 200 if ours else 100, options)
    assert arrived.mean() >= (1 if ours else 0.99)


@given(SHARES, SHARES, st.integers(1, 3))
def test_poses_within_limits_are_reached(there: np.ndarray, start: np.ndarray, finger: int) -> None:
    low, high = HAND.limits.T
    pose = HAND.link_poses(f"pad_{finger}", low + there * (high - low))
    begin = low + start * (high - low)
    found = HAND.inverse_kinematics(f"pad_{finger}", pose, begin)
    assert found.arrived.all()
    # The other fingers stay as they were.
    others = [i for i, joint in enumerate(HAND.dof_names) if not joint.endswith(str(finger))]
    np.testing.assert_array_equal(found.q[0, others], begin[others])


def test_a_pose_out_of_reach_is_said_and_does_not_disturb_the_others() -> None:
    gripper = named("parallel_gripper")
    poses = gripper.link_poses("finger_left", [[0.01], [0.03], [0.02]])
    poses[1, 0] -= 0.05
    poses[2, 2] += 1e-3
    found = gripper.inverse_kinematics("finger_left", poses)
    np.testing.assert_array_equal(found.arrived, [True, False, False])
    # As near as the slide comes: its end, and the foot of the perpendicular.
    np.testing.assert_allclose(found.q[:, 0], [0.01, 0.04, 0.02], atol=1e-7)
    np.testing.assert_allclose(found.position_error_m, [0, 0.04, 1e-3], atol=1e-7)
    assert found.attempts[0] == 1 and found.attempts[1] == IKOptions().attempts
    alone = gripper.inverse_kinematics("finger_left", poses[:1])
    np.testing.assert_array_equal(alone.q, found.q[:1])
    # Far away and turned over.
    far, over = REST.copy(), REST.copy()
    far[:, 2] += 1.0
    over[:, 3:] = [0, 0, 0, 1]  # The pad looks outwards.
    for pose in (far, over):
        found = HAND.inverse_kinematics("pad_1", pose, options=IKOptions(attempts=3))
        assert not found.arrived.any()
    free = IKOptions(position_only=True)
    assert HAND.inverse_kinematics("pad_1", over, options=free).arrived.all()


def test_the_base_s_place_and_the_seed_do_not_matter_for_the_answer() -> None:
    moved = HAND.placed([0.3, -0.2, 0.5, 0.5, 0.5, 0.5, 0.5])
    q = random_coordinates(moved, 5)
    for seed in (0, 7):
        options = IKOptions(seed=seed)
        found = moved.inverse_kinematics("pad_3", moved.link_poses("pad_3", q), None, options)
        assert found.arrived.all()
        # A finger's three joints bring its pad to a pose in one way only.
        np.testing.assert_allclose(found.q[:, 6:], q[:, 6:], atol=1e-4)


test_bad_questions_are_refused = refuses(
    lambda call: call(),
    (
        lambda: HAND.inverse_kinematics("pad_1", REST, np.zeros((2, 9))),
        "start has 2 rows, expected 1 or one",
    ),
    (lambda: HAND.inverse_kinematics("pad_1", 2 * REST), "unit length"),
    (lambda: IKOptions(attempts=0), "attempts must be at least 1, got 0"),
    (
        lambda: IKOptions(position_tolerance_m=float("nan")),
        "position_tolerance_m must be positive and finite, got nan",
    ),
)
