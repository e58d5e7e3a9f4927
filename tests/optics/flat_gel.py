# SPDX-License-Identifier: Apache-2.0
"""A flat gel without a mesh whose light can be written down."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from taccel_lab.optics.render import OpticalModel
from taccel_lab.profile.optical_design import Coating, DesignedCamera, Light, OpticalDesign, Window
from tests.support.formula_model import formula_model

CAMERA_Z = -30.0
GEL_MM = 4.0


def flat_top(xy_mm: np.ndarray) -> np.ndarray:
    return np.zeros(np.shape(xy_mm)[:-1])


def camera(**changes: Any) -> DesignedCamera:
    values: dict[str, Any] = {
        "width_px": 41,
        "height_px": 31,
        "fx_px": 60.0,
        "fy_px": 60.0,
        "cx_px": 20.0,
        "cy_px": 15.0,
        "position_mm": (0.0, 0.0, CAMERA_Z),
    }
    return DesignedCamera(**{**values, **changes})


def design(*lights: Light, **changes: Any) -> OpticalDesign:
    values: dict[str, Any] = {"camera": camera(), "coating": Coating((0.4, 0.5, 0.6))}
    return OpticalDesign(lights=lights, **{**values, **changes})


def model(
    optics: OpticalDesign,
    top: Callable[[np.ndarray], np.ndarray] = flat_top,
    half: float = 15.0,
    **options: Any,
) -> OpticalModel:
    options.setdefault("step_mm", 0.5)
    return formula_model(optics, top, half_size_mm=(half, half), back_z_mm=-GEL_MM, **options)


PLATE = Window(3.0, (30.0, 30.0), 1.49)


def towards(azimuth_deg: float, elevation_deg: float, distance_mm: float) -> tuple[Any, Any]:
    """Position of a light and its direction to the origin; elevation above the face, inside."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    way = np.array([
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        -np.sin(elevation),
    ])  # fmt: skip
    return tuple((distance_mm * way).tolist()), tuple((-way).tolist())
