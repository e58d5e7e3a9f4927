# SPDX-License-Identifier: Apache-2.0
"""The public names and their modules; read by type checkers and by ``lazy_names``."""

from taccel_lab.bodies.bodies import AffineBody as AffineBody
from taccel_lab.bodies.bodies import Element as Element
from taccel_lab.bodies.bodies import KinematicBody as KinematicBody
from taccel_lab.bodies.bodies import Plane as Plane
from taccel_lab.bodies.bodies import SoftBody as SoftBody
from taccel_lab.bodies.bodies import Surface as Surface
from taccel_lab.bodies.joints import FixedJoint as FixedJoint
from taccel_lab.bodies.joints import Joint as Joint
from taccel_lab.bodies.joints import PositionDrive as PositionDrive
from taccel_lab.bodies.joints import PrismaticJoint as PrismaticJoint
from taccel_lab.bodies.joints import RevoluteJoint as RevoluteJoint
from taccel_lab.bodies.joints import VelocityDrive as VelocityDrive
from taccel_lab.bodies.mass_properties import StatedMass as StatedMass
from taccel_lab.bodies.material import Material as Material
from taccel_lab.bodies.material import MaterialField as MaterialField
from taccel_lab.bodies.material import MaterialModel as MaterialModel
from taccel_lab.bodies.material import MaxwellBranch as MaxwellBranch
from taccel_lab.bodies.primitives import Ball as Ball
from taccel_lab.bodies.primitives import TriangleMesh as TriangleMesh
from taccel_lab.bodies.primitives import box_mesh as box_mesh
from taccel_lab.bodies.primitives import cylinder_mesh as cylinder_mesh
from taccel_lab.bodies.primitives import sphere_mesh as sphere_mesh
from taccel_lab.bodies.scene_description import TimeScheme as TimeScheme
from taccel_lab.bodies.scene_description import TimeStepping as TimeStepping
from taccel_lab.scene.scene import Scene as Scene
