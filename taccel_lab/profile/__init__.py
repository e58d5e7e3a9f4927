# SPDX-License-Identifier: Apache-2.0
"""Sensor profiles: one validated, versioned folder that says everything about a sensor.

The public names load their modules on first use (PEP 562): the plain data of ``optical_design``
is for machines without pydantic, too.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from taccel_lab.profile.io import (
        Finding,
        load_profile,
        require_profile_folder,
        save_profile,
        validate_profile,
    )
    from taccel_lab.profile.optics_blocks import (
        CoatingBlock,
        HousingBlock,
        LightEntry,
        LightsBlock,
        MarkersBlock,
        OpticsBlock,
        WindowBlock,
    )
    from taccel_lab.profile.response_blocks import (
        DepthResponseBlock,
        NormalsBlock,
        PerturbationBlock,
    )
    from taccel_lab.profile.schema import (
        SCHEMA_VERSION,
        BackgroundBlock,
        Block,
        CameraBlock,
        ColorBlock,
        FittedWith,
        GelBlock,
        LayerMaterial,
        MaterialBlock,
        Provenance,
        SensorBlock,
    )
    from taccel_lab.profile.sensor_profile import SensorProfile

__all__ = [
    "SCHEMA_VERSION",
    "BackgroundBlock",
    "Block",
    "CameraBlock",
    "CoatingBlock",
    "ColorBlock",
    "DepthResponseBlock",
    "Finding",
    "FittedWith",
    "GelBlock",
    "HousingBlock",
    "LayerMaterial",
    "LightEntry",
    "LightsBlock",
    "MarkersBlock",
    "MaterialBlock",
    "NormalsBlock",
    "OpticsBlock",
    "PerturbationBlock",
    "Provenance",
    "SensorBlock",
    "SensorProfile",
    "WindowBlock",
    "load_profile",
    "require_profile_folder",
    "save_profile",
    "validate_profile",
]

_HOMES = {
    "taccel_lab.profile.io": (
        "Finding",
        "load_profile",
        "require_profile_folder",
        "save_profile",
        "validate_profile",
    ),
    "taccel_lab.profile.optics_blocks": (
        "CoatingBlock",
        "HousingBlock",
        "LightEntry",
        "LightsBlock",
        "MarkersBlock",
        "OpticsBlock",
        "WindowBlock",
    ),
    "taccel_lab.profile.response_blocks": (
        "DepthResponseBlock",
        "NormalsBlock",
        "PerturbationBlock",
    ),
    "taccel_lab.profile.schema": (
        "SCHEMA_VERSION",
        "BackgroundBlock",
        "Block",
        "CameraBlock",
        "ColorBlock",
        "FittedWith",
        "GelBlock",
        "LayerMaterial",
        "MaterialBlock",
        "Provenance",
        "SensorBlock",
    ),
    "taccel_lab.profile.sensor_profile": ("SensorProfile",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'taccel_lab.profile' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)
