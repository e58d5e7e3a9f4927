# SPDX-License-Identifier: Apache-2.0
"""Joints as actions: steps and targets, within limits and reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.joint_control import JointControl
from taccel_lab.robots import named
from taccel_lab.tasks import catalogue
from taccel_lab.tasks.grasp_lift import GraspLiftParameters

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
HAND = named("three_finger_hand")
STEP = np.full(9, 0.1)
EVERYONE = torch.tensor([True, True])


def test_steps_stay_within_limits() -> None:
    control = JointControl(HAND, HAND.rest_q, STEP)
    control.attach(2, "cpu")
    action = torch.zeros(2, 9, dtype=torch.float64)
    action[0], action[1, 2] = 0.5, -1.0
    for _ in range(40):
        control.act(EVERYONE, action)
    np.testing.assert_allclose(control.q[0], np.tile([0.5, 1.4, 1.6], 3), atol=1e-12)
    assert control.q[1, 2] == -0.3 and not control.q[1, [0, 1, 3, 4, 5, 6, 7, 8]].any()
    np.testing.assert_allclose(control.poses(), HAND.targets(control.q.numpy()), atol=1e-12)
    np.testing.assert_allclose(control.told()[1, 2], -np.degrees(0.3))
    assert control.names[:2] == ("spread_1_deg", "knuckle_1_deg")
    before = control.q.clone()
    control.act(torch.tensor([False, True]), -action)
    assert torch.equal(control.q[0], before[0]) and control.q[1, 2] == pytest.approx(-0.2)
    control.begin(torch.tensor([True, False]))
    assert not control.q[0].any() and control.q[1, 2] == pytest.approx(-0.2)


def test_targets_are_approached_at_the_joint_s_speed() -> None:
    gripper = named("parallel_gripper")
    control = JointControl(gripper, np.array([0.03]), np.array([4e-3]), actions="target")
    control.attach(1, "cpu")
    found = []
    for _ in range(4):
        control.act(EVERYONE[:1], torch.tensor([[0.0]]))
        found.append(control.told().item())
    np.testing.assert_allclose(found, [26, 22, 20, 20], atol=1e-9)
    assert control.names == ("slide_left_mm",)
    near = JointControl(
        gripper, np.array([0.03]), np.array([1.0]), actions="target", reach=np.array([5e-3])
    )
    near.attach(1, "cpu")
    for action, wanted in ((-1.0, 25.0), (1.0, 35.0)):
        near.act(EVERYONE[:1], torch.tensor([[action]]))
        assert near.told().item() == pytest.approx(wanted)


def test_nothing_is_read_from_the_device() -> None:
    """Tensors on torch's device "meta" have no values: whatever asks for one fails."""
    control = JointControl(HAND, HAND.rest_q, STEP, actions="target")
    control.attach(4, "meta")
    who = torch.ones(4, dtype=torch.bool, device="meta")
    control.begin(who)
    control.act(who, torch.zeros((4, 9), device="meta"))
    assert control.poses().shape == (4, len(HAND.kinematic_bodies()), 7)


def test_what_cannot_be_controlled_is_refused() -> None:
    with pytest.raises(InputError, match=r"coordinate 2 of joint 'spread_1' .* out of its limits"):
        JointControl(HAND, np.full(9, 2.0), STEP)
    endless = replace(
        HAND, joints=(replace(HAND.joints[0], lower=-np.inf, upper=np.inf), *HAND.joints[1:])
    )
    with pytest.raises(InputError, match="joint 'spread_1' has no limits that a target could lie"):
        JointControl(endless, HAND.rest_q, STEP, actions="target")
    JointControl(endless, HAND.rest_q, STEP, actions="target", reach=np.full(9, 0.5))


def test_an_environment_takes_targets() -> None:
    task = catalogue.named("grasp-lift-hand")
    assert isinstance(task.parameters, GraspLiftParameters)
    learning = task.parameters.learning.replace(joint_actions="target")
    task = replace(task, parameters=task.parameters.replace(learning=learning))
    env = make_vec(task, 1, observe=("proprioception",), device="cpu")
    first = env.reset(seed=0)[0]["proprioception"][0]
    action = torch.zeros(1, 13)
    action[0, 5], action[0, 6] = 1.0, -1.0
    for _ in range(3):
        seen = env.step(action)[0]["proprioception"][0]
    step = learning.joint_speed * task.parameters.dt_s
    np.testing.assert_allclose(seen[5] - first[5], 3 * step, atol=1e-3)
    np.testing.assert_allclose(seen[6] - first[6], -3 * step, atol=1e-3)
