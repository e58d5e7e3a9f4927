# SPDX-License-Identifier: Apache-2.0
"""Design and calibrate vision-based tactile sensors on an IPC solver.

Importing this package is cheap: the public names below load their modules on first use (PEP 562),
and heavy libraries load in the functions that need them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from taccel_lab.errors import InputError, SimulationError
    from taccel_lab.geometry import PixelGrid, Region, TetMesh
    from taccel_lab.profile import SensorProfile, load_profile, save_profile, validate_profile

__all__ = [
    "InputError",
    "PixelGrid",
    "Region",
    "SensorProfile",
    "SimulationError",
    "TetMesh",
    "__version__",
    "load_profile",
    "save_profile",
    "validate_profile",
]

_HOME = {
    "InputError": "taccel_lab.errors",
    "SimulationError": "taccel_lab.errors",
    "PixelGrid": "taccel_lab.geometry",
    "Region": "taccel_lab.geometry",
    "TetMesh": "taccel_lab.geometry",
    "SensorProfile": "taccel_lab.profile",
    "load_profile": "taccel_lab.profile",
    "save_profile": "taccel_lab.profile",
    "validate_profile": "taccel_lab.profile",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'taccel_lab' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
