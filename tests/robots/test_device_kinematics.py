# SPDX-License-Identifier: Apache-2.0
"""Kinematics of tensors: those of numpy, on their device, with slopes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.robots import Robot, load_urdf, named
from tests.support.robot_files import CHAIN, REAL, random_coordinates, write

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
DEVICES = [
    "cpu",
    pytest.param(
        "cuda",
        marks=[
            pytest.mark.gpu,
            pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device"),
        ],
    ),
]


def turned(robot: Robot) -> Robot:
    return robot.placed([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5])


def of(name: str, folder: Path) -> Robot:
    return turned(load_urdf(write(folder, CHAIN)) if name == "chain" else named(name))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", ["parallel_gripper", "three_finger_hand", "chain", *REAL])
def test_tensors_go_where_arrays_go(name: str, device: str, tmp_path: Path) -> None:
    robot = of(name, tmp_path)
    q = random_coordinates(robot, 50)
    tensor = torch.tensor(q, device=device)
    link = robot.link_names[-1]
    for found, wanted in (
        (robot.forward_kinematics(tensor), robot.forward_kinematics(q)),
        (robot.link_poses(link, tensor), robot.link_poses(link, q)),
        (robot.targets(tensor), robot.targets(q)),
        (robot.targets(tensor, check=False), robot.targets(q)),
        (robot.jacobian(link, tensor), robot.jacobian(link, q)),
    ):
        assert found.device == tensor.device and found.dtype is torch.float64
        np.testing.assert_allclose(found.cpu().numpy(), wanted, rtol=0, atol=1e-12)
    assert isinstance(robot.forward_kinematics(q), np.ndarray)
    # Policies speak float32; poses are computed in float64 all the same.
    narrow = tensor.float()
    wanted = robot.forward_kinematics(narrow.double())
    torch.testing.assert_close(robot.forward_kinematics(narrow), wanted, rtol=0, atol=0)


@pytest.mark.parametrize("name", ["three_finger_hand", "chain", *REAL])
def test_autograd_follows_the_poses(name: str, tmp_path: Path) -> None:
    """Slopes of a link's place are the rows of the Jacobian."""
    robot = of(name, tmp_path)
    link = max(robot.link_names, key=lambda name: len(robot.tree.path_to(name)))
    q = torch.tensor(random_coordinates(robot, 6), requires_grad=True)
    place = robot.link_poses(link, q)
    jacobian = robot.jacobian(link, q)
    for axis in range(3):
        (slope,) = torch.autograd.grad(place[:, axis].sum(), q, retain_graph=True)
        torch.testing.assert_close(slope, jacobian[:, axis], rtol=0, atol=1e-12)
    # Quaternions x: 2 dx = (spin) x, wherever their largest part is.
    spin, turn = jacobian[:, 3:], place[:, 3:]
    for k, unit in enumerate(torch.eye(3, dtype=torch.float64)):
        (slope,) = torch.autograd.grad(place[:, 3 + k].sum(), q, retain_graph=True)
        columns = spin.transpose(1, 2)
        across = torch.linalg.cross(columns, turn[:, None, :3].expand_as(columns))
        wanted = 0.5 * ((columns * turn[:, None, 3:] + across) @ unit)
        torch.testing.assert_close(slope, wanted, rtol=0, atol=1e-12)


def test_unchecked_targets_read_nothing_from_the_device() -> None:
    """Tensors on torch's device "meta" have no values: whatever asks for one fails."""
    robot = named("three_finger_hand")
    q = torch.zeros((5, robot.dof), device="meta")
    assert robot.targets(q, check=False).shape == (5, len(robot.kinematic_bodies()), 7)
    assert robot.forward_kinematics(q, check=False).shape == (5, len(robot.links), 7)
    assert robot.jacobian("pad_1", q, check=False).shape == (5, 6, 9)
    with pytest.raises((RuntimeError, NotImplementedError)):
        robot.targets(q)


def test_what_is_wrong_of_tensors_is_said_as_of_arrays() -> None:
    hand = named("three_finger_hand")
    q = torch.zeros((2, 9))
    q[1, 4] = 1.5
    with pytest.raises(InputError, match=r"coordinate 1.5 of joint 'knuckle_2' in row 1 is out of"):
        hand.targets(q)
    q[1, 4] = torch.nan
    with pytest.raises(InputError, match="hold NaN or infinite"):
        hand.forward_kinematics(q)
    assert torch.isfinite(hand.targets(q, check=False)[0]).all()
    for wrong in (torch.zeros(2, 8), torch.zeros(2, 2, 9), np.zeros((2, 2, 9)), 0.0):
        with pytest.raises(InputError, match=r"must have shape \[9\] or \[n, 9\]"):
            hand.targets(wrong)


def test_robots_move_without_torch() -> None:
    code = (
        "import sys; from taccel_lab.robots import named; r = named('three_finger_hand'); "
        "r.targets(r.rest_q); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
