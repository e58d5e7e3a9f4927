# SPDX-License-Identifier: Apache-2.0
"""Sensor profiles: one validated, versioned folder that says everything about a sensor."""

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
