# SPDX-License-Identifier: Apache-2.0
"""The blocks that captures calibrate: to add one, write its folder and a line here."""

from __future__ import annotations

from pkgutil import resolve_name

from taccel_lab.calibration.block import Block

HOMES = {
    "camera": "taccel_lab.calibration.camera.block",
    "scale": "taccel_lab.calibration.scale.block",
    "background": "taccel_lab.calibration.background.block",
    "color": "taccel_lab.calibration.color.block",
    "normals": "taccel_lab.calibration.normals.block",
    "depth": "taccel_lab.calibration.depth.block",
    "markers": "taccel_lab.calibration.markers.block",
    "material": "taccel_lab.calibration.material.block",
}
"""Modules that hold each ``BLOCK``, in the order in which one builds on another."""


def block_named(name: str) -> Block:
    """The block of this name; the others are not loaded."""
    return resolve_name(f"{HOMES[name]}:BLOCK")


def all_blocks() -> tuple[Block, ...]:
    """All of them, in their order."""
    return tuple(block_named(name) for name in HOMES)
