# SPDX-License-Identifier: Apache-2.0
"""URDF files that tests write: a chain of every kind of joint, and real robots if installed."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.robots import Robot

INSTALLED = True
try:
    metadata.distribution("example-robot-data")
except metadata.PackageNotFoundError:
    INSTALLED = False
needs_real_robots = pytest.mark.skipif(
    not INSTALLED, reason="the extra robots (example-robot-data) is not installed"
)
REAL_NAMES = ("panda", "panda_hand", "allegro_left", "allegro_right", "ur5_gripper")
REAL = [pytest.param(name, marks=needs_real_robots) for name in REAL_NAMES]

CHAIN = """
<robot name="chain">
  <link name="base"/>
  <link name="arm">
    <inertial>
      <origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/>
      <mass value="2"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.25"/>
    </inertial>
    <visual><geometry><mesh filename="looks.dae"/></geometry></visual>
    <collision>
      <origin xyz="0 0 0.1"/>
      <geometry><box size="0.02 0.03 0.2"/></geometry>
    </collision>
  </link>
  <link name="slide"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
  <link name="wheel">
    <collision>
      <origin rpy="1.5707963267948966 0 0"/>
      <geometry><cylinder radius="0.02" length="0.01"/></geometry>
    </collision>
  </link>
  <link name="tip"/>
  <link name="thumb"/>
  <link name="nail"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="arm"/>
    <origin xyz="0.01 -0.02 0.03" rpy="0.3 -0.4 0.5"/>
    <axis xyz="0 3 4"/>
    <limit lower="-2" upper="1.5" effort="7" velocity="1"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="arm"/><child link="slide"/>
    <origin xyz="0 0 0.2" rpy="1 0 0"/>
    <axis xyz="0.6 0 0.8"/>
    <limit lower="-0.05" upper="0.1" effort="50" velocity="1"/>
  </joint>
  <joint name="spin" type="continuous">
    <parent link="slide"/><child link="wheel"/>
    <origin rpy="0 2 0"/>
  </joint>
  <joint name="bond" type="fixed">
    <parent link="wheel"/><child link="tip"/><origin xyz="0.03 0 0"/>
  </joint>
  <joint name="follow" type="revolute">
    <parent link="arm"/><child link="thumb"/>
    <origin xyz="0.05 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
    <mimic joint="shoulder" multiplier="-0.8" offset="0.1"/>
  </joint>
  <joint name="nail_slide" type="prismatic">
    <parent link="thumb"/><child link="nail"/>
    <axis xyz="0 0 1"/>
    <limit lower="-0.1" upper="0.1" effort="1" velocity="1"/>
    <mimic joint="lift" multiplier="0.5"/>
  </joint>
  <transmission name="motor"><type>simple</type></transmission>
  <gazebo reference="arm"/>
</robot>
"""


def write(folder: Path, text: str, name: str = "robot.urdf") -> Path:
    """A file in a folder."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def random_coordinates(robot: Robot, count: int, seed: int = 0) -> np.ndarray:
    """Coordinates within the limits, a turn either way where there are none, [count, dof]."""
    low, high = np.clip(robot.limits, -2 * np.pi, 2 * np.pi).T
    return np.random.default_rng(seed).uniform(low, high, (count, robot.dof))
