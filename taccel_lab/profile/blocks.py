# SPDX-License-Identifier: Apache-2.0
"""All blocks of the present schema version, in the order of the file."""

from __future__ import annotations

from taccel_lab.profile.optics_blocks import (
    CoatingBlock,
    HousingBlock,
    LightsBlock,
    MarkersBlock,
    OpticsBlock,
    WindowBlock,
)
from taccel_lab.profile.response_blocks import (
    DepthResponseBlock,
    ForceBlock,
    NormalsBlock,
    PerturbationBlock,
)
from taccel_lab.profile.schema import (
    BackgroundBlock,
    Block,
    CameraBlock,
    ColorBlock,
    GelBlock,
    MaterialBlock,
    SensorBlock,
)

_REQUIRED: tuple[type[Block], ...] = (SensorBlock, GelBlock, MaterialBlock, CameraBlock)
_OPTIONAL: tuple[type[Block], ...] = (
    OpticsBlock,
    WindowBlock,
    CoatingBlock,
    LightsBlock,
    MarkersBlock,
    HousingBlock,
    BackgroundBlock,
    ColorBlock,
    NormalsBlock,
    DepthResponseBlock,
    PerturbationBlock,
    ForceBlock,
)
BLOCK_TYPES = _REQUIRED + _OPTIONAL
OPTIONAL_BLOCKS = frozenset(block.key for block in _OPTIONAL)
