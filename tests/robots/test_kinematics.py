# SPDX-License-Identifier: Apache-2.0
"""Where links are, of arrays and tensors: against yourdfpy, closed forms, differences, autograd."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.robots import Robot, load_urdf, named, names
from taccel_lab.robots.catalogue import ENTRIES
from taccel_lab.robots.transforms import matrix_of, pose_of
from tests.support.robot_files import CHAIN, REAL, random_coordinates, write

yourdfpy = pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
IDENTITY = np.array([0, 0, 0, 0, 0, 0, 1.0])


def differences_to_yourdfpy(robot: Robot, urdf: Path, base: str) -> np.ndarray:
    """Largest difference of any link's matrix (metres, and cosines) over 100 poses, [100]."""
    peer = yourdfpy.URDF.load(str(urdf), load_meshes=False)
    q = random_coordinates(robot, 100)
    ours = matrix_of(robot.forward_kinematics(q))
    worst = np.zeros(len(q))
    for k, row in enumerate(q):
        peer.update_cfg(dict(zip(robot.dof_names, row.tolist(), strict=True)))
        for i, link in enumerate(robot.link_names):
            theirs = peer.get_transform(link, base)
            worst[k] = max(worst[k], np.abs(ours[k, i] - theirs).max())
    return worst


@pytest.mark.parametrize("name", ["parallel_gripper", "three_finger_hand", *REAL])
def test_links_are_where_yourdfpy_has_them(name: str) -> None:
    (entry,) = (entry for entry in ENTRIES if entry.name == name)
    robot = named(name)
    assert differences_to_yourdfpy(robot, entry.path(), robot.base).max() < 1e-12


def test_every_kind_of_joint_is_where_yourdfpy_has_it(tmp_path: Path) -> None:
    path = write(tmp_path, CHAIN)
    robot = load_urdf(path)
    assert robot.dof_names == ["shoulder", "lift", "spin"]
    assert robot.base == "base" and robot.dof == 3
    assert differences_to_yourdfpy(robot, path, "base").max() < 1e-12


def test_a_turn_and_a_slide_by_hand(tmp_path: Path) -> None:
    robot = load_urdf(
        write(
            tmp_path,
            """
            <robot name="two">
              <link name="a"/><link name="b"/><link name="c"/>
              <joint name="turn" type="continuous">
                <parent link="a"/><child link="b"/><origin xyz="1 0 0"/><axis xyz="0 0 2"/>
              </joint>
              <joint name="slide" type="prismatic">
                <parent link="b"/><child link="c"/><axis xyz="1 0 0"/>
                <limit lower="0" upper="1" effort="1" velocity="1"/>
              </joint>
            </robot>
            """,
        )
    )
    half = np.sqrt(0.5)
    poses = robot.forward_kinematics([np.pi / 2, 0.25])
    np.testing.assert_allclose(poses[0, 1], [1, 0, 0, 0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(poses[0, 2], [1, 0.25, 0, 0, 0, half, half], atol=1e-15)
    np.testing.assert_array_equal(robot.link_poses("c", [np.pi / 2, 0.25]), poses[:, 2])
    moved = robot.placed([0, 0, 5, half, 0, 0, half]).forward_kinematics([np.pi / 2, 0.25])
    # A quarter of a turn about x brings y to z.
    np.testing.assert_allclose(moved[0, 2, :3], [1, 0, 5.25], atol=1e-15)


def test_a_follower_s_follower_goes_with_the_leader(tmp_path: Path) -> None:
    text = CHAIN.replace('mimic joint="lift" multiplier="0.5"', 'mimic joint="follow"')
    robot = load_urdf(write(tmp_path, text))
    thumb, nail = robot.link_id("thumb"), robot.link_id("nail")
    poses = robot.forward_kinematics([[0.1, 0, 0], [-0.02, 0.05, 1]])
    slide = np.linalg.norm(poses[:, nail, :3] - poses[:, thumb, :3], axis=1)
    np.testing.assert_allclose(slide, [0.02, 0.116], atol=1e-12)
    # shoulder * -0.8 + 0.1 stays within the slide's [-0.1, 0.1].
    np.testing.assert_allclose(robot.limits[0], [0, 0.25], atol=1e-12)


@pytest.mark.parametrize("name", ["parallel_gripper", "three_finger_hand", "chain", *REAL])
def test_jacobian_is_the_slope_of_the_pose(name: str, tmp_path: Path) -> None:
    robot = load_urdf(write(tmp_path, CHAIN)) if name == "chain" else named(name)
    robot = robot.placed([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5])
    q = random_coordinates(robot, 4, seed=3)
    h = 1e-5
    largest = 0.0
    for link in (robot.link_names[-1], robot.link_names[len(robot.links) // 2]):
        jacobian = robot.jacobian(link, q)
        assert jacobian.shape == (4, 6, robot.dof)
        turn = matrix_of(robot.link_poses(link, q))[:, :3, :3]
        for i in range(robot.dof):
            step = h * np.eye(robot.dof)[i]
            ahead, behind = (matrix_of(robot.link_poses(link, q + s)) for s in (step, -step))
            slope = (ahead - behind) / (2 * h)
            np.testing.assert_allclose(slope[:, :3, 3], jacobian[:, :3, i], atol=2e-9)
            spin = slope[:, :3, :3] @ turn.transpose(0, 2, 1)
            found = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
            np.testing.assert_allclose(found, jacobian[:, 3:, i], atol=2e-9)
        largest = max(largest, float(np.abs(jacobian).max()))
    assert largest > 0.5


def test_attached_robots_move_as_alone() -> None:
    hand, gripper = named("three_finger_hand"), named("parallel_gripper")
    place = np.array([0.01, 0.02, 0.03, 0, np.sqrt(0.5), 0, np.sqrt(0.5)])
    both = hand.attach("pad_2", gripper, place, "grip/").attach("pad_1", gripper, IDENTITY, "b/")
    assert both.dof_names == [*hand.dof_names, "grip/slide_left", "b/slide_left"]
    q = random_coordinates(both, 5)
    found = matrix_of(both.link_poses("grip/finger_right", q))
    carrier = matrix_of(hand.link_poses("pad_2", q[:, :9]))
    finger = matrix_of(gripper.link_poses("finger_right", q[:, 9:10]))
    np.testing.assert_allclose(found, carrier @ matrix_of(place) @ finger, atol=1e-14)
    part = both.part("grip/palm")
    assert part.dof_names == ["grip/slide_left"] and part.base == "grip/palm"
    np.testing.assert_allclose(
        part.link_poses("grip/finger_right", q[:, 9:10]), pose_of(finger), atol=1e-14
    )
    with pytest.raises(InputError, match="2 links are called 'grip/palm'"):
        both.attach("pad_3", gripper, IDENTITY, "grip/")


def test_a_part_does_not_mimic_what_it_left_behind(tmp_path: Path) -> None:
    robot = load_urdf(write(tmp_path, CHAIN))
    assert robot.part("slide").dof_names == ["spin"]
    with pytest.raises(InputError, match="'nail_slide' mimics 'lift', which is no joint"):
        robot.part("thumb")


def test_coordinates_and_links_that_are_not_there_are_refused() -> None:
    hand = named("three_finger_hand")
    with pytest.raises(InputError, match=r"must have shape \[9\] or \[n, 9\] \('spread_1', .*got"):
        hand.forward_kinematics(np.zeros((2, 8)))
    with pytest.raises(InputError, match="hold NaN or infinite"):
        hand.forward_kinematics(np.full(9, np.nan))
    with pytest.raises(InputError, match="has no link 'thumb'; there are 'palm', 'base_1'"):
        hand.jacobian("thumb", np.zeros(9))
    with pytest.raises(InputError, match="unit length"):
        hand.placed([0, 0, 0, 1, 1, 0, 0])
    with pytest.raises(InputError, match=r"world_from_base must have shape \[7\]"):
        hand.placed(np.tile(IDENTITY, (2, 1)))


def test_names_of_the_catalogue() -> None:
    assert names()[:2] == ["parallel_gripper", "three_finger_hand"]
    with pytest.raises(InputError, match=r"no robot 'hand'.*known: parallel_gripper, three_"):
        named("hand")


@pytest.mark.parametrize("name", REAL)
def test_real_robots_have_the_joints_of_their_makers(name: str) -> None:
    wanted = {"panda": 8, "panda_hand": 1, "allegro_left": 16, "allegro_right": 16}
    assert named(name).dof == wanted.get(name, 6)


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from taccel_lab.robots import catalogue

    monkeypatch.setattr(catalogue, "PACKAGE", "no-such-robot-data")
    with pytest.raises(InputError, match=r"no-such-robot-data, which is not installed: pip inst"):
        named("panda")


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


@pytest.mark.thorough(cases=("parallel_gripper-cpu",))
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


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_robots_move_without_torch() -> None:
    code = (
        "import sys; from taccel_lab.robots import named; r = named('three_finger_hand'); "
        "r.targets(r.rest_q); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
