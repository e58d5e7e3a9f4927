# SPDX-License-Identifier: Apache-2.0
"""Models of newton that the tests of the bridge read, and newton's own kinematics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.newton_bridge.importing import coordinate_names
from taccel_lab.newton_bridge.newton_model import NewtonModel, unit_poses
from taccel_lab.robots import Robot
from taccel_lab.robots.transforms import matrix_of

newton = pytest.importorskip("newton", reason="newton is not installed")
ASSETS = Path(newton.__file__).parent / "examples" / "assets"

ARM = """
<mujoco model="arm">
  <worldbody>
    <body name="base" pos="0.1 0.2 0.3" quat="0.8 0.2 0.4 0.4">
      <geom type="box" size="0.05 0.04 0.03"/>
      <body name="upper" pos="0 0 0.1" euler="10 20 30">
        <joint name="shoulder" type="hinge" axis="1 2 3" pos="0.03 -0.02 0.01" range="-60 80"/>
        <geom type="capsule" size="0.01 0.05"/>
        <body name="fore" pos="0.1 0 0">
          <joint name="out" type="slide" axis="0 1 1" pos="0.3 0.2 0.1" range="-0.1 0.2"/>
          <joint name="roll" type="hinge" axis="1 0 0" pos="0 0.01 0" range="-90 90"/>
          <joint name="tilt" type="hinge" axis="0 1 0" range="-45 45"/>
          <geom type="sphere" size="0.02"/>
          <body name="finger" pos="0 0 0.05">
            <joint name="left" type="slide" axis="1 0 0" range="0 0.04"/>
            <geom type="cylinder" size="0.005 0.02"/>
          </body>
          <body name="thumb" pos="0 0 -0.05">
            <joint name="right" type="slide" axis="-1 0 0" range="0 0.04"/>
            <geom type="ellipsoid" size="0.005 0.006 0.007"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/></equality>
</mujoco>
"""


def newton_frames(source: NewtonModel, robot: Robot, q: np.ndarray) -> dict[str, np.ndarray]:
    """world_from_body by newton's ``eval_fk`` for one row of the robot's coordinates, by name."""
    values = robot.tree.factors @ q + robot.tree.offsets
    by_joint = {joint.name: value for joint, value in zip(robot.joints, values, strict=True)}
    model = source.model
    joint_q = model.joint_q.numpy()
    for i in range(model.joint_count):
        first = int(model.joint_q_start.numpy()[i])
        for k, name in enumerate(coordinate_names(source, i)):
            if name in by_joint:
                joint_q[first + k] = by_joint[name]
    state = model.state()
    newton.eval_fk(model, wp.array(joint_q, dtype=wp.float32), model.joint_qd, state)
    return dict(zip(source.bodies, matrix_of(unit_poses(state.body_q.numpy())), strict=True))


def largest_difference(builder: Any, robot: Robot) -> float:
    """Largest difference of any body's matrix (metres, and cosines) over random coordinates."""
    source = NewtonModel(builder)
    low, high = np.clip(robot.limits, -np.pi, np.pi).T
    q = np.random.default_rng(0).uniform(low, high, (100, robot.dof))
    ours = matrix_of(robot.forward_kinematics(q))
    worst = 0.0
    for k, row in enumerate(q):
        for name, frame in newton_frames(source, robot, row).items():
            if name in robot.link_names:
                worst = max(worst, float(np.abs(ours[k, robot.link_id(name)] - frame).max()))
    return worst


def read(text: str, tmp_path: Path) -> Any:
    path = tmp_path / "robot.xml"
    path.write_text(text, encoding="utf-8")
    builder = newton.ModelBuilder()
    builder.add_mjcf(str(path))
    return builder
