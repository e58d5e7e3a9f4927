# SPDX-License-Identifier: Apache-2.0
"""Robots from URDF: what they are made of, and their kinematics, forward and inverse."""

from taccel_lab.robots.catalogue import named, names
from taccel_lab.robots.inverse_kinematics import IKOptions, IKResult
from taccel_lab.robots.robot import Robot
from taccel_lab.robots.urdf import load_urdf

__all__ = ["IKOptions", "IKResult", "Robot", "load_urdf", "named", "names"]
