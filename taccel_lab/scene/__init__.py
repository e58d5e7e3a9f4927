# SPDX-License-Identifier: Apache-2.0
"""Host-side description of a scene: bodies, materials, motion. ``Scene.finalize`` makes a Model."""

from taccel_lab.scene.bodies import AffineBody, KinematicBody, Plane, SoftBody, Surface
from taccel_lab.scene.description import Scene, TimeScheme, TimeStepping
from taccel_lab.scene.element import Element
from taccel_lab.scene.joints import (
    FixedJoint,
    Joint,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    VelocityDrive,
)
from taccel_lab.scene.material import Material, MaterialField, MaterialModel
from taccel_lab.scene.primitives import (
    Ball,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)

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
    "Surface",
    "TimeScheme",
    "TimeStepping",
    "TriangleMesh",
    "VelocityDrive",
    "box_mesh",
    "cylinder_mesh",
    "sphere_mesh",
]
