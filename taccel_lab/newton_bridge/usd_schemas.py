# SPDX-License-Identifier: Apache-2.0
"""Prims and schemas of USD that are understood, and their numbers; others are refused by name.

https://openusd.org/release/api/usd_physics_page_front.html
"""

from __future__ import annotations

import math
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import shown

_READ = (
    "", "Xform", "Scope", "Cube", "Sphere", "Cylinder", "Capsule", "Cone", "Plane", "Mesh",
    "PhysicsScene", "PhysicsFixedJoint", "PhysicsRevoluteJoint", "PhysicsPrismaticJoint",
    "PhysicsJoint", "PhysicsCollisionGroup",
)  # fmt: skip
"""Types of prims that newton reads."""
_IDLE = (
    "Material", "Shader", "NodeGraph", "GeomSubset", "Camera", "BasisCurves", "Points", "Backdrop",
    "RenderProduct", "RenderSettings", "RenderVar", "OmniGraph", "OmniGraphNode", "MjcActuator",
    "MjcKeyframe", "NewtonActuator",
)  # fmt: skip
"""Types without influence on kinematics, masses, shapes, contacts and limits: looks and drives.
Lights are, too."""
_APIS = (
    "PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI", "PhysicsMeshCollisionAPI",
    "PhysicsMaterialAPI", "PhysicsArticulationRootAPI", "PhysicsLimitAPI", "PhysicsDriveAPI",
    "PhysicsFilteredPairsAPI", "PhysicsJointStateAPI", "TensorPhysicsArticulationRootAPI",
    "NewtonArticulationRootAPI", "NewtonCollisionAPI", "NewtonMassAPI", "NewtonMaterialAPI",
    "NewtonMeshCollisionAPI", "NewtonMimicAPI", "NewtonSiteAPI", "MjcCollisionAPI", "MjcJointAPI",
    "MjcMaterialAPI", "MjcMeshCollisionAPI", "MjcSiteAPI", "PhysxMimicJointAPI",
    # Solvers, drives and contacts of other programs, looks and notes.
    "NewtonSceneAPI", "MjcSceneAPI", "MjcImageableAPI", "NewtonPDControlAPI",
    "NewtonMaxEffortClampingAPI", "NewtonActuatorDelayAPI", "PhysxArticulationAPI",
    "PhysxCollisionAPI", "PhysxContactReportAPI", "PhysxConvexDecompositionCollisionAPI",
    "PhysxConvexHullCollisionAPI", "PhysxJointAPI", "PhysxJointAxisAPI", "PhysxLimitAPI",
    "PhysxMaterialAPI", "PhysxRigidBodyAPI", "PhysxSceneAPI", "PhysxTriangleMeshCollisionAPI",
    "warpSceneAPI", "CollectionAPI", "ConnectableAPI", "CoordSysAPI", "GeomModelAPI", "LightAPI",
    "MaterialBindingAPI", "MeshLightAPI", "MotionAPI", "NodeDefAPI", "SemanticsAPI",
    "SemanticsLabelsAPI", "ShadowAPI", "ShapingAPI", "VisibilityAPI",
)  # fmt: skip
"""Applied schemas that are read, or are without such influence; OmniRtx... are, too."""
_AT_LEAST_0 = (
    "mass", "density", "diagonalInertia", "staticFriction", "dynamicFriction", "restitution",
    "stiffness", "damping", "maxForce",
)  # fmt: skip
"""Numbers of physics that are at least 0."""
_ENDLESS = ("lowerLimit", "upperLimit", "low", "high", "maxForce", "breakForce", "breakTorque",
            "gravityMagnitude", "gravityDirection", "centerOfMass", "principalAxes")  # fmt: skip
"""Numbers that may be infinite, which stands for none."""


def check_prim(spec: Any) -> None:
    """Refuse a prim of a layer, by name, whose type or schemas are not understood, or whose numbers
    no physics has."""
    path, kind = spec.path, spec.typeName
    if kind not in (*_READ, *_IDLE) and not kind.endswith("Light"):
        raise InputError(f"{path} is a {shown(kind)}, which is not understood: remove it")
    for name in applied(spec):
        if name.split(":")[0] not in _APIS and not name.startswith("OmniRtx"):
            raise InputError(f"{shown(name)} of {path} is not understood: remove it")
    numbers = {}
    for attribute in spec.attributes:
        value = attribute.default
        if "physics:" in attribute.name and not isinstance(value, (str, bool, type(None))):
            numbers[attribute.name] = _checked(attribute.name, str(path), value)
    # Low above high means locked where there are several axes.
    low, high = (numbers.get(f"physics:{end}Limit", [0.0]) for end in ("lower", "upper"))
    if len(numbers.keys() & {"physics:lowerLimit", "physics:upperLimit"}) == 2 and low > high:
        raise InputError(
            f"physics:lowerLimit of {path} must not be above its upperLimit, got {low[0]:g} and "
            f"{high[0]:g}"
        )


def _checked(name: str, path: str, value: Any) -> list[float]:
    import numpy as np

    try:
        values = np.asarray(value, dtype=float).ravel().tolist()
    except (TypeError, ValueError):
        return []  # A quaternion; newton refuses one of no length.
    own = name.rpartition(":")[2]
    wanted = "finite" if own not in _ENDLESS else "numbers"
    wrong = any(math.isnan(one) or (wanted == "finite" and math.isinf(one)) for one in values)
    if own in _AT_LEAST_0:
        wanted, wrong = f"{wanted} and at least 0", wrong or min(values, default=0.0) < 0
    if wrong:
        raise InputError(f"{name} of {path} must be {wanted}, got {values[0]:g}")
    return values


def applied(spec: Any) -> list[str]:
    """Schemas that a prim of a layer applies."""
    found = spec.GetInfo("apiSchemas") if spec.HasInfo("apiSchemas") else None
    return [] if found is None else [str(name) for name in found.GetAppliedItems()]
