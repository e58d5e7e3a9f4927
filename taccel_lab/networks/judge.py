# SPDX-License-Identifier: Apache-2.0
"""The judge of a profile's networks: settings, weights, camera and answers have to agree.

Every profile that is made is judged, whichever way it came; the same network once in a process.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.networks.color_settings import (
    ColorModelConfig,
    fitted_cone_deg,
    require_cone,
    require_levels,
)
from taccel_lab.networks.force_settings import ForceModelConfig, require_forces, with_color_limits
from taccel_lab.networks.normal_settings import NormalModelConfig, require_angles
from taccel_lab.networks.settings import checked_weights, require_camera_size

Weights = Mapping[str, np.ndarray]
_MOST_KEPT = 256
_faults: dict[tuple[bytes, str], str | None] = {}
"""Verdicts by digest of the weights, and by all else."""


def network_fault(
    key: str,
    architecture: Mapping[str, Any],
    weights: Weights,
    size_px: tuple[int, int],
    valid_region: Mapping[str, tuple[float, float]],
) -> str | None:
    """Why a block's settings and weights make no network for a camera; None where they do.

    Args:
        key: Of the block: color, normals or force.
        architecture: Its settings.
        weights: Its arrays by name, finite.
        size_px: Width and height of the camera's images.
        valid_region: Of the block's provenance.
    """
    digest = hashlib.sha256()
    for name in sorted(weights):
        array = np.ascontiguousarray(weights[name])
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(array.tobytes())
    cone_deg = fitted_cone_deg(valid_region)
    known = digest.digest(), json.dumps([key, architecture, size_px, cone_deg])
    if known not in _faults:
        while len(_faults) >= _MOST_KEPT:
            del _faults[next(iter(_faults))]
        try:
            _judge(key, architecture, weights, size_px, cone_deg)
        except InputError as fault:
            _faults[known] = str(fault)
        else:
            _faults[known] = None
    return _faults[known]


def _judge(
    key: str,
    architecture: Mapping[str, Any],
    weights: Weights,
    size_px: tuple[int, int],
    cone_deg: float,
) -> None:
    config: ColorModelConfig | NormalModelConfig | ForceModelConfig
    match key:
        case "color":
            config = ColorModelConfig.from_dict(architecture)
            require_camera_size(key, (config.width_px, config.height_px), size_px)
            require_cone(cone_deg)
            require_levels(
                config, checked_weights("color model", config.weight_shapes(), weights), cone_deg
            )
        case "normals":
            config = NormalModelConfig.from_dict(architecture)
            require_camera_size(key, (config.width_px, config.height_px), size_px)
            require_angles(config, checked_weights("normal model", config.weight_shapes(), weights))
        case _:
            config = ForceModelConfig.from_dict(architecture)
            require_camera_size(key, (config.width_px, config.height_px), size_px)
            weights = with_color_limits(weights)
            require_forces(config, checked_weights("force model", config.weight_shapes(), weights))
