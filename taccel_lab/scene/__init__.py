# SPDX-License-Identifier: Apache-2.0
"""Scenes, and what they are made of: bodies, materials, joints, shapes of ``taccel_lab.bodies``."""

from taccel_lab.bodies.bodies import AffineBody, KinematicBody, Plane, SoftBody, Surface
from taccel_lab.bodies.element import Element
from taccel_lab.bodies.joints import (
    FixedJoint,
    Joint,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    VelocityDrive,
)
from taccel_lab.bodies.mass_properties import StatedMass
from taccel_lab.bodies.material import Material, MaterialField, MaterialModel
from taccel_lab.bodies.primitives import (
    Ball,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)
from taccel_lab.bodies.scene_description import TimeScheme, TimeStepping
from taccel_lab.scene.scene import Scene

__all__ = [
    "AffineBody",
    "Ball",
    "Element",
    "FixedJoint",
    "Joint",
    "KinematicBody",
    "Material",
    "MaterialField",
    "MaterialModel",
    "Plane",
    "PositionDrive",
    "PrismaticJoint",
    "RevoluteJoint",
    "Scene",
    "SoftBody",
    "StatedMass",
    "Surface",
    "TimeScheme",
    "TimeStepping",
    "TriangleMesh",
    "VelocityDrive",
    "box_mesh",
    "cylinder_mesh",
    "sphere_mesh",
]
