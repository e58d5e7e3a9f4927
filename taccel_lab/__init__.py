# SPDX-License-Identifier: Apache-2.0
"""Design and calibrate vision-based tactile sensors on an IPC solver.

Importing this package is cheap: the public names below load their modules on first use (PEP 562),
and heavy libraries load in the functions that need them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from taccel_lab.version import __version__

if TYPE_CHECKING:
    from taccel_lab.envs import (
        Accuracy,
        PressEnv,
        PressOutcome,
        PressPath,
        parse_indenter,
        profile_material,
        simulate_press,
    )
    from taccel_lab.errors import InputError, SimulationError
    from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
    from taccel_lab.model import Model
    from taccel_lab.optics.photometry import measure_photometry
    from taccel_lab.optics.render import OpticalModel
    from taccel_lab.outputs import Outputs, to_torch
    from taccel_lab.profile.io import load_profile, save_profile, validate_profile
    from taccel_lab.profile.optical_design import OpticalDesign
    from taccel_lab.profile.sensor_profile import SensorProfile
    from taccel_lab.scene import (
        AffineBody,
        Ball,
        Element,
        FixedJoint,
        KinematicBody,
        Material,
        MaterialField,
        MaterialModel,
        Plane,
        PositionDrive,
        PrismaticJoint,
        RevoluteJoint,
        Scene,
        SoftBody,
        Surface,
        TimeScheme,
        TimeStepping,
        TriangleMesh,
        VelocityDrive,
        box_mesh,
        cylinder_mesh,
        sphere_mesh,
    )
    from taccel_lab.signals import (
        MarkerLayout,
        SignalFusedSurface,
        SignalTactile,
        SurfaceMode,
    )
    from taccel_lab.solvers import EnvStatus, ShardedSolver, SolverConfig, SolverIPC, StepReport
    from taccel_lab.state import State, initial_state

__all__ = [
    "Accuracy",
    "AffineBody",
    "Ball",
    "Element",
    "EnvStatus",
    "FixedJoint",
    "InputError",
    "KinematicBody",
    "MarkerLayout",
    "Material",
    "MaterialField",
    "MaterialModel",
    "Model",
    "OpticalDesign",
    "OpticalModel",
    "Outputs",
    "PixelGrid",
    "Plane",
    "PositionDrive",
    "PressEnv",
    "PressOutcome",
    "PressPath",
    "PrismaticJoint",
    "QuadraticMesh",
    "Region",
    "RevoluteJoint",
    "Scene",
    "SensorProfile",
    "ShardedSolver",
    "SignalFusedSurface",
    "SignalTactile",
    "SimulationError",
    "SoftBody",
    "SolverConfig",
    "SolverIPC",
    "State",
    "StepReport",
    "Surface",
    "SurfaceMode",
    "TetMesh",
    "TimeScheme",
    "TimeStepping",
    "TriangleMesh",
    "VelocityDrive",
    "__version__",
    "box_mesh",
    "cylinder_mesh",
    "initial_state",
    "load_profile",
    "measure_photometry",
    "parse_indenter",
    "profile_material",
    "save_profile",
    "simulate_press",
    "sphere_mesh",
    "to_torch",
    "validate_profile",
]

_HOMES = {
    "taccel_lab.envs": (
        "Accuracy",
        "PressEnv",
        "PressOutcome",
        "PressPath",
        "parse_indenter",
        "profile_material",
        "simulate_press",
    ),
    "taccel_lab.errors": ("InputError", "SimulationError"),
    "taccel_lab.geometry": ("PixelGrid", "QuadraticMesh", "Region", "TetMesh"),
    "taccel_lab.model": ("Model",),
    "taccel_lab.optics.photometry": ("measure_photometry",),
    "taccel_lab.optics.render": ("OpticalModel",),
    "taccel_lab.outputs": ("Outputs", "to_torch"),
    "taccel_lab.profile.io": ("load_profile", "save_profile", "validate_profile"),
    "taccel_lab.profile.optical_design": ("OpticalDesign",),
    "taccel_lab.profile.sensor_profile": ("SensorProfile",),
    "taccel_lab.scene": (
        "AffineBody",
        "Ball",
        "Element",
        "FixedJoint",
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
    ),
    "taccel_lab.signals": (
        "MarkerLayout",
        "SignalFusedSurface",
        "SignalTactile",
        "SurfaceMode",
    ),
    "taccel_lab.solvers": ("EnvStatus", "ShardedSolver", "SolverConfig", "SolverIPC", "StepReport"),
    "taccel_lab.state": ("State", "initial_state"),
}
"""Module of each public name."""
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'taccel_lab' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
