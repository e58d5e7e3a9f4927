# SPDX-License-Identifier: Apache-2.0
"""Host-side description of a scene: bodies, materials, motion. ``Scene.finalize`` makes a Model."""

from taccel_lab.scene.description import KinematicBody, Scene, SoftBody, TimeStepping
from taccel_lab.scene.material import Material, MaterialField, MaterialModel
from taccel_lab.scene.primitives import (
    Ball,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)

__all__ = [
    "Ball",
    "KinematicBody",
    "Material",
    "MaterialField",
    "MaterialModel",
    "Scene",
    "SoftBody",
    "TimeStepping",
    "TriangleMesh",
    "box_mesh",
    "cylinder_mesh",
    "sphere_mesh",
]
