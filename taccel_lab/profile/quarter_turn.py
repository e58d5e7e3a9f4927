# SPDX-License-Identifier: Apache-2.0
"""A sensor whose image is turned by a quarter, clockwise as one looks at the image.

What pointed right in the image then points down: x, y, z of the gel frame become -y, x, z. The
sensor is turned as a rigid body, its camera with it, so that the picture is the same, turned.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from taccel_lab.geometry import TetMesh
from taccel_lab.profile.sensor_profile import SensorProfile
from taccel_lab.profile.sensor_view import BLOCK_TYPES, MAIN_VIEW


def quarter_turned(profile: SensorProfile) -> SensorProfile:
    """The designed sensor, turned; blocks that hold images or networks are left out.

    The block ``sensor`` stays: its parameters describe the sensor as it lay.
    """
    lying = profile.seen_by(MAIN_VIEW).without(
        "background", "color", "normals", "depth_response", "perturbation", "force"
    )
    changes: dict[str, Any] = {"mesh": _mesh(lying.mesh)}
    for block in BLOCK_TYPES:
        found = getattr(lying, block.key)
        if found is not None and block.key in _TURNS:
            changes[block.key] = found.replace(**_TURNS[block.key](found))
    turned = dataclasses.replace(lying, **changes)
    for name in profile.views:
        turned = turned.with_view(name, quarter_turned(profile.seen_by(name)))
    return turned


def _xy(values: Any) -> tuple[float, ...]:
    x, y, *rest = values
    return (-y + 0.0, x, *rest)


def _swapped(values: Any) -> tuple[float, ...]:
    x, y, *rest = values
    return (y, x, *rest)


def _mesh(mesh: TetMesh) -> TetMesh:
    nodes = np.stack([-mesh.nodes_m[:, 1], mesh.nodes_m[:, 0], mesh.nodes_m[:, 2]], axis=1)
    return dataclasses.replace(mesh, nodes_m=nodes)


def _camera(block: Any) -> dict[str, Any]:
    return {
        "width_px": block.height_px,
        "height_px": block.width_px,
        "mm_per_px_x": block.mm_per_px_y,
        "mm_per_px_y": block.mm_per_px_x,
        "center_u_px": block.height_px - 1 - block.center_v_px,
        "center_v_px": block.center_u_px,
    }


def _optics(block: Any) -> dict[str, Any]:
    distortion = list(block.distortion)
    if block.model == "pinhole" and len(distortion) >= 4:
        # Tangential terms are those of a tilted lens: the axis of the tilt turns.
        distortion[2], distortion[3] = distortion[3], -distortion[2]
    x, y, z, w = block.rotation
    return {
        "width_px": block.height_px,
        "height_px": block.width_px,
        "fx_px": block.fy_px,
        "fy_px": block.fx_px,
        "cx_px": block.height_px - 1 - block.cy_px,
        "cy_px": block.cx_px,
        "distortion": tuple(distortion),
        "position_mm": _xy(block.position_mm),
        # q r q^-1 of a turn q about z: the axis of r turns, its angle stays.
        "rotation": (*_xy((x, y)), z, w),
        "raw_width_px": block.raw_height_px,
        "raw_height_px": block.raw_width_px,
        "crop_x": block.crop_y,
        "crop_y": block.crop_x,
    }


def _window(block: Any) -> dict[str, Any]:
    return {"size_mm": _swapped(block.size_mm)}


def _lights(block: Any) -> dict[str, Any]:
    return {
        "led": tuple(
            led.model_copy(
                update={"position_mm": _xy(led.position_mm), "direction": _xy(led.direction)}
            )
            for led in block.led
        )
    }


def _markers(block: Any) -> dict[str, Any]:
    return {
        "offset_mm": _xy(block.offset_mm),
        "rotation_deg": (block.rotation_deg + 90.0 + 180.0) % 360.0 - 180.0,
    }


def _housing(block: Any) -> dict[str, Any]:
    return {"size_mm": _swapped(block.size_mm), "offset_mm": _xy(block.offset_mm)}


_TURNS = {
    "camera": _camera,
    "optics": _optics,
    "window": _window,
    "lights": _lights,
    "markers": _markers,
    "housing": _housing,
}
