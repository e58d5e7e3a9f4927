# SPDX-License-Identifier: Apache-2.0
"""All blocks of the present schema version, and what each camera of a sensor has of its own.

A camera has pixels, optics, and what was fitted to its images.

Gel, material, window, coating, lights, markers and housing are there once, whoever looks at them.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.profile.optional_blocks import (
    CoatingBlock,
    DepthResponseBlock,
    ForceBlock,
    HousingBlock,
    LightsBlock,
    MarkersBlock,
    NormalsBlock,
    OpticsBlock,
    PerturbationBlock,
    WindowBlock,
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

MAIN_VIEW = "main"
"""Name of the view that a profile holds itself."""
MOST_VIEWS = 16
_NAME = re.compile(r"[a-z0-9][a-z0-9_]{0,39}")


@dataclass(frozen=True, eq=False)
class SensorView:
    """A further camera of a sensor; fields as of ``SensorProfile``."""

    sensor: SensorBlock
    """Sensor block of this camera: how its images were recorded, and its own parameters."""
    camera: CameraBlock
    optics: OpticsBlock | None = None
    background: BackgroundBlock | None = None
    background_rgb: np.ndarray | None = None
    color: ColorBlock | None = None
    color_weights: Mapping[str, np.ndarray] | None = None
    normals: NormalsBlock | None = None
    normal_weights: Mapping[str, np.ndarray] | None = None
    depth_response: DepthResponseBlock | None = None
    perturbation: PerturbationBlock | None = None
    force: ForceBlock | None = None
    force_weights: Mapping[str, np.ndarray] | None = None

    @classmethod
    def of(cls, profile: object) -> SensorView:
        """The main view of a ``SensorProfile``, such as one calibrated with this camera."""
        return cls(**{name: getattr(profile, name) for name in _FIELDS})

    def parts(self) -> dict[str, Any]:
        """Blocks and arrays by their field of ``SensorProfile``."""
        return {name: getattr(self, name) for name in _FIELDS}


_FIELDS = tuple(f.name for f in dataclasses.fields(SensorView))
VIEW_KEYS = tuple(name for name in _FIELDS if not name.endswith(("_rgb", "_weights")))
"""Blocks of a view."""
OWN_KEYS = ("sensor", "camera")
"""Blocks that every view has."""


def require_view_name(name: object) -> str:
    """Refuse what cannot be the name of a further view: it is a folder, and ``main`` is taken."""
    if not isinstance(name, str) or not _NAME.fullmatch(name) or name == MAIN_VIEW:
        raise InputError(
            f"views: {str(name)[:60]!r} is no name of a view; allowed: up to 40 of a-z, 0-9 and _, "
            f"but not {MAIN_VIEW}, the profile's own camera"
        )
    return name


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
