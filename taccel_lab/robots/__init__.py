# SPDX-License-Identifier: Apache-2.0
"""Robots that carry gels: from URDF into a scene, with kinematics forward and inverse."""

from taccel_lab.robots.catalogue import named, names
from taccel_lab.robots.driven import DrivenRobot, drive
from taccel_lab.robots.inverse_kinematics import IKOptions, IKResult
from taccel_lab.robots.mounts import on_seat
from taccel_lab.robots.robot import Robot
from taccel_lab.robots.urdf import load_urdf

__all__ = [
    "DrivenRobot",
    "IKOptions",
    "IKResult",
    "Robot",
    "drive",
    "load_urdf",
    "named",
    "names",
    "on_seat",
]
