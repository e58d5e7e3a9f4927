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
from taccel_lab.robots import Robot, catalogue, load_urdf, named, names
from taccel_lab.robots.transforms import matrix_of, pose_of
from tests.robots.gels import IDENTITY
from tests.support.robot_files import CHAIN, REAL, random_coordinates, write
from tests.support.sensor_refusals import refuses

OURS = ("parallel_gripper", "three_finger_hand")
DOF = {
    "parallel_gripper": 1, "three_finger_hand": 9, "chain": 3, "panda": 8, "panda_hand": 1,
    "allegro_left": 16, "allegro_right": 16, "ur5_gripper": 6,
}  # fmt: skip
"""By their makers."""
HALF = np.sqrt(0.5)


def turned(name: str, folder: Path) -> Robot:
    """A robot of the catalogue, or the chain, somewhere in the world."""
    robot = load_urdf(write(folder, CHAIN)) if name == "chain" else named(name)
    return robot.placed([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5])


@pytest.mark.parametrize("name", [*OURS, "chain", *REAL])
def test_links_are_where_yourdfpy_has_them(name: str, tmp_path: Path) -> None:
    yourdfpy = pytest.importorskip("yourdfpy", reason="the referee yourdfpy is not installed")
    path = write(tmp_path, CHAIN)
    if name != "chain":
        (path,) = (entry.path() for entry in catalogue.ENTRIES if entry.name == name)
    robot = load_urdf(path) if name == "chain" else named(name)
    assert robot.dof == DOF[name]
    peer = yourdfpy.URDF.load(str(path), load_meshes=False)
    q = random_coordinates(robot, 100)
    ours = matrix_of(robot.forward_kinematics(q))
    for k, row in enumerate(q):
        peer.update_cfg(dict(zip(robot.dof_names, row.tolist(), strict=True)))
        theirs = [peer.get_transform(link, robot.base) for link in robot.link_names]
        assert np.abs(ours[k] - theirs).max() < 1e-12


def test_a_turn_and_a_slide_by_hand(tmp_path: Path) -> None:
    text = """<robot name="two"><link name="a"/><link name="b"/><link name="c"/>
      <joint name="turn" type="continuous">
        <parent link="a"/><child link="b"/><origin xyz="1 0 0"/><axis xyz="0 0 2"/>
      </joint>
      <joint name="slide" type="prismatic">
        <parent link="b"/><child link="c"/><axis xyz="1 0 0"/>
        <limit lower="0" upper="1" effort="1" velocity="1"/>
      </joint></robot>"""
    robot = load_urdf(write(tmp_path, text))
    poses = robot.forward_kinematics([np.pi / 2, 0.25])
    np.testing.assert_allclose(poses[0, 1], [1, 0, 0, 0, 0, HALF, HALF], atol=1e-15)
    np.testing.assert_allclose(poses[0, 2], [1, 0.25, 0, 0, 0, HALF, HALF], atol=1e-15)
    np.testing.assert_array_equal(robot.link_poses("c", [np.pi / 2, 0.25]), poses[:, 2])
    moved = robot.placed([0, 0, 5, HALF, 0, 0, HALF]).forward_kinematics([np.pi / 2, 0.25])
    # A quarter of a turn about x brings y to z.
    np.testing.assert_allclose(moved[0, 2, :3], [1, 0, 5.25], atol=1e-15)


def test_a_follower_s_follower_goes_with_the_leader(tmp_path: Path) -> None:
    text = CHAIN.replace('mimic joint="lift" multiplier="0.5"', 'mimic joint="follow"')
    robot = load_urdf(write(tmp_path, text))
    assert robot.dof_names == ["shoulder", "lift", "spin"] and robot.base == "base"
    poses = robot.forward_kinematics([[0.1, 0, 0], [-0.02, 0.05, 1]])[..., :3]
    apart = poses[:, robot.link_id("nail")] - poses[:, robot.link_id("thumb")]
    np.testing.assert_allclose(np.linalg.norm(apart, axis=1), [0.02, 0.116], atol=1e-12)
    # shoulder * -0.8 + 0.1 stays within the slide's [-0.1, 0.1].
    np.testing.assert_allclose(robot.limits[0], [0, 0.25], atol=1e-12)
    # A part does not mimic what it left behind.
    assert robot.part("slide").dof_names == ["spin"]
    with pytest.raises(InputError, match="'nail_slide' mimics 'follow', which is no joint"):
        robot.part("thumb")


@pytest.mark.parametrize("name", [*OURS, "chain", *REAL])
def test_jacobian_is_the_slope_of_the_pose(name: str, tmp_path: Path) -> None:
    robot = turned(name, tmp_path)
    q, h = random_coordinates(robot, 4, seed=3), 1e-5
    largest = 0.0
    for link in (robot.link_names[-1], robot.link_names[len(robot.links) // 2]):
        jacobian = robot.jacobian(link, q)
        assert jacobian.shape == (4, 6, robot.dof)
        turn = matrix_of(robot.link_poses(link, q))[:, :3, :3]
        for i, step in enumerate(h * np.eye(robot.dof)):
            ahead, behind = (matrix_of(robot.link_poses(link, q + s)) for s in (step, -step))
            slope = (ahead - behind) / (2 * h)
            spin = slope[:, :3, :3] @ turn.transpose(0, 2, 1)
            found = [*slope[:, :3, 3].T, spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]]
            np.testing.assert_allclose(np.stack(found, axis=1), jacobian[:, :, i], atol=2e-9)
        largest = max(largest, float(np.abs(jacobian).max()))
    assert largest > 0.5


def test_attached_robots_move_as_alone() -> None:
    hand, gripper = named("three_finger_hand"), named("parallel_gripper")
    place = np.array([0.01, 0.02, 0.03, 0, HALF, 0, HALF])
    both = hand.attach("pad_2", gripper, place, "grip/").attach("pad_1", gripper, IDENTITY, "b/")
    assert both.dof_names == [*hand.dof_names, "grip/slide_left", "b/slide_left"]
    q = random_coordinates(both, 5)
    found = matrix_of(both.link_poses("grip/finger_right", q))
    carrier = matrix_of(hand.link_poses("pad_2", q[:, :9]))
    finger = matrix_of(gripper.link_poses("finger_right", q[:, 9:10]))
    np.testing.assert_allclose(found, carrier @ matrix_of(place) @ finger, atol=1e-14)
    part = both.part("grip/palm")
    assert part.dof_names == ["grip/slide_left"] and part.base == "grip/palm"
    alone = part.link_poses("grip/finger_right", q[:, 9:10])
    np.testing.assert_allclose(alone, pose_of(finger), atol=1e-14)
    with pytest.raises(InputError, match="2 links are called 'grip/palm'"):
        both.attach("pad_3", gripper, IDENTITY, "grip/")


SHAPE = r"must have shape \[9\] or \[n, 9\] \('spread_1', .*got"
BEYOND = torch.zeros(2, 9)
BEYOND[1, 4] = 1.5
ONE_NAN = torch.where(BEYOND > 0, torch.nan, BEYOND)


test_what_is_not_there_is_refused = refuses(
    lambda call: call(named("three_finger_hand")),
    (lambda hand: hand.forward_kinematics(np.zeros((2, 8))), SHAPE),
    (lambda hand: hand.targets(torch.zeros(2, 8)), SHAPE),
    (lambda hand: hand.targets(torch.zeros(2, 2, 9)), SHAPE),
    (lambda hand: hand.targets(np.zeros((2, 2, 9))), SHAPE),
    (lambda hand: hand.targets(0.0), SHAPE),
    (lambda hand: hand.forward_kinematics(np.full(9, np.nan)), "hold NaN or infinite"),
    (lambda hand: hand.forward_kinematics(ONE_NAN), "hold NaN or infinite"),
    (lambda hand: hand.targets(BEYOND), "coordinate 1.5 of joint 'knuckle_2' in row 1 is out"),
    (lambda hand: hand.jacobian("thumb", np.zeros(9)), "no link 'thumb'; there are 'palm', 'b"),
    (lambda hand: hand.placed([0, 0, 0, 1, 1, 0, 0]), "unit length"),
    (lambda hand: hand.placed([IDENTITY] * 2), r"world_from_base must have shape \[7\]"),
    (lambda _: named("hand"), "no robot 'hand'.*did you mean .*hand"),
)


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tuple(names()[:2]) == OURS
    monkeypatch.setattr(catalogue, "PACKAGE", "no-such-robot-data")
    with pytest.raises(InputError, match=r"no-such-robot-data, which is not installed: pip inst"):
        named("panda")


NO_CUDA = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA device")


@pytest.mark.thorough(cases=("parallel_gripper-cpu", "three_finger_hand-cpu"))
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=[pytest.mark.gpu, NO_CUDA])])
@pytest.mark.parametrize("name", [*OURS, "chain", *REAL])
def test_tensors_go_where_arrays_go(name: str, device: str, tmp_path: Path) -> None:
    robot = turned(name, tmp_path)
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
        assert isinstance(wanted, np.ndarray)
        np.testing.assert_allclose(found.cpu().numpy(), wanted, rtol=0, atol=1e-12)
    # Policies speak float32; poses are computed in float64 all the same.
    narrow = tensor.float()
    wanted = robot.forward_kinematics(narrow.double())
    torch.testing.assert_close(robot.forward_kinematics(narrow), wanted, rtol=0, atol=0)
    if robot.dof == 9:  # A row that is wrong does not reach the others.
        assert torch.isfinite(robot.targets(ONE_NAN, check=False)[0]).all()


@pytest.mark.parametrize("name", ["three_finger_hand", "chain", *REAL])
def test_autograd_follows_the_poses(name: str, tmp_path: Path) -> None:
    """Slopes of a link's place are the rows of the Jacobian."""
    robot = turned(name, tmp_path)
    link = max(robot.link_names, key=lambda name: len(robot.tree.path_to(name)))
    q = torch.tensor(random_coordinates(robot, 6), requires_grad=True)
    pose = robot.link_poses(link, q)
    jacobian = robot.jacobian(link, q)
    slopes = [torch.autograd.grad(x.sum(), q, retain_graph=True)[0] for x in pose.T]
    # Quaternions x: 2 dx = (spin) x, wherever their largest part is.
    columns, turn = jacobian[:, 3:].transpose(1, 2), pose[:, 3:]
    across = torch.linalg.cross(columns, turn[:, None, :3].expand_as(columns))
    spin = 0.5 * (columns * turn[:, None, 3:] + across)
    wanted = torch.cat([jacobian[:, :3], spin.transpose(1, 2)], dim=1)
    torch.testing.assert_close(torch.stack(slopes[:6], dim=1), wanted, rtol=0, atol=1e-12)


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


@pytest.mark.thorough
def test_robots_move_without_torch() -> None:
    code = (
        "import sys; from taccel_lab.robots import named; r = named('three_finger_hand'); "
        "r.targets(r.rest_q); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
